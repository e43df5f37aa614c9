"""LaFAN1's takes."""

from fractions import Fraction
from pathlib import Path

import pytest

from motionkit.io.lafan1 import read_lafan1
from motionkit.io.scan import read, scan
from tests.helpers.bones import check_body
from tests.helpers.format_samples import lafan1_text


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
    take = read_lafan1(path)
    assert take.fps == 30 and take.num_frames == 130
    assert not take.skeleton.offsets[0].any()
    check_body(take)
    assert take.joint_positions[0, 0, 1] == pytest.approx(0.91882)
    resolved = tmp_path / "walk1_subject2.bvh"
    resolved.write_text(lafan1_text(8, frame_time="0.016667"))
    assert read_lafan1(resolved).fps == Fraction(60)
