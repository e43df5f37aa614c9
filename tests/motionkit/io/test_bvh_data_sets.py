"""LaFAN1's and 100STYLE's BVH files: what names and tables say of them."""

from fractions import Fraction
from pathlib import Path

import pytest

from motionkit.io.bvh_data_sets import read_100style, read_lafan1
from motionkit.io.scan import read, scan
from tests.helpers.bones import check_body
from tests.helpers.format_samples import NUM_BVH_CHANNELS, bvh_text, lafan1_text
from tests.helpers.refusal import refusal


def test_theme_subject_and_split_are_in_the_name(tmp_path: Path) -> None:
    folder = tmp_path / "lafan1"
    folder.mkdir()
    for name in ("walk1_subject1", "pushAndStumble2_subject5", "walk_subject1", "walk2_actor1"):
        (folder / f"{name}.bvh").write_text(lafan1_text(4))
    motions = {motion.sequence_id: motion for motion in map(read, scan([folder]).items)}
    known = {name.rpartition("/")[2]: motion for name, motion in motions.items() if motion.action}
    assert {name: (m.action, m.provenance.subject, m.split) for name, m in known.items()} == {
        "walk1_subject1": ("walk", "subject1", "train"),
        "pushAndStumble2_subject5": ("pushAndStumble", "subject5", "test"),
    }
    assert {m.provenance.source_format for m in known.values()} == {"lafan1"}
    assert motions["lafan1/walk_subject1"].provenance.source_format == "bvh"
    assert len({m.skeleton for m in known.values()}) == 1


def test_the_body_stands_in_metres_at_its_framerate(tmp_path: Path) -> None:
    path = tmp_path / "walk1_subject5.bvh"
    path.write_text(lafan1_text(130))
    take = read_lafan1(path).motion
    assert take.fps == 30 and take.num_frames == 130
    assert not take.skeleton.offsets[0].any()
    check_body(take)
    assert take.joint_positions[0, 0, 1] == pytest.approx(0.91882)
    resolved = tmp_path / "walk1_subject2.bvh"
    resolved.write_text(lafan1_text(8, frame_time="0.016667"))
    assert read_lafan1(resolved).motion.fps == Fraction(60)


HEADER = "STYLE_NAME,BR_START,BR_STOP,FW_START,FW_STOP,TR2_START,TR2_STOP"


def rows(num_frames: int = 10) -> list[list[float]]:
    return [[0.0, 95.0, float(frame), *([0.5] * (NUM_BVH_CHANNELS - 3))] for frame in range(num_frames)]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    root = tmp_path / "100STYLE"
    for style in ("Aeroplane", "Old"):
        (root / style).mkdir(parents=True)
        for kind in ("BR", "FW"):
            (root / style / f"{style}_{kind}.bvh").write_text(bvh_text(rows(), frame_time="0.016667"))
    (root / "Frame_Cuts.csv").write_text(f"{HEADER}\r\nAeroplane,2,7,3.0,10.0,N/A,N/A\r\nOld,0,1,0,10,,\r\n")
    (root / "Dataset_List.csv").write_text("Style Name,Description\nOld,Old man\n")
    return root


def test_takes_are_cut_and_know_style_and_movement(folder: Path) -> None:
    found = scan([folder])
    assert not found.problems and not found.warnings
    motions = {item.path.stem: read(item) for item in found.items}
    assert {
        name: (m.style, m.action, m.num_frames, round(float(m.joint_positions[0, 0, 2]), 4))
        for name, m in motions.items()
    } == {
        "Aeroplane_BR": ("Aeroplane", "backward run", 5, 0.02),
        "Aeroplane_FW": ("Aeroplane", "forward walk", 7, 0.03),
        "Old_BR": ("Old", "backward run", 1, 0.0),
        "Old_FW": ("Old", "forward walk", 10, 0.0),
    }
    motion = motions["Aeroplane_BR"]
    assert motion.fps == 60 and motion.timegrid.start_seconds == 0.0
    assert motion.provenance.source_format == "100style"


@pytest.mark.parametrize(
    "table",
    [
        f"{HEADER}\nOld,0,1,0,10,,\n",
        f"{HEADER}\nAeroplane,0,11,0,10,,\n",
        f"{HEADER}\nAeroplane,-1,5,0,10,,\n",
        "name,start\nAeroplane,1\n",
        "STYLE_NAME\n\xff\n",
    ],
)
def test_a_bad_table_is_refused(folder: Path, table: str) -> None:
    (folder / "Frame_Cuts.csv").write_bytes(table.encode("latin-1"))
    assert "Frame_Cuts.csv" in str(refusal(read_100style, folder / "Aeroplane" / "Aeroplane_BR.bvh"))
