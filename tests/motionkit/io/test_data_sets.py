"""LaFAN1, 100STYLE, UESTC and DeepMimic: what names and tables say of their files, poses that are known, bad files."""

import json
import pickle
import re
import subprocess
import sys
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import map_joints
from motionkit.io.bvh_data_sets import read_100style, read_lafan1
from motionkit.io.deepmimic import humanoid3d, read_deepmimic
from motionkit.io.scan import read, scan
from motionkit.io.uestc import ACTIONS, TRAIN_SUBJECTS, read_uestc
from tests.helpers.bones import check_body
from tests.helpers.format_samples import NUM_BVH_CHANNELS, bvh_text, lafan1_text
from tests.helpers.refusal import refusal
from tests.helpers.repository import REPOSITORY


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


def pose(num_frames: int = 3, view: int = 0) -> np.ndarray:
    """Standing before a camera (y down, z away) and facing the front one, seen by the camera of a view."""
    poses = np.zeros((num_frames, 72), np.float32)
    seen = Rotation.from_euler("y", 45.0 * view, degrees=True) * Rotation.from_rotvec([np.pi, 0.0, 0.0])
    poses[:, :3] = seen.as_rotvec()
    return poses


def write_uestc(path: Path, **arrays: np.ndarray) -> Path:
    np.savez(path, **({"pose": pose()} | arrays))
    return path


def test_names_say_action_subject_and_set(tmp_path: Path) -> None:
    folder = tmp_path / "uestc"
    folder.mkdir()
    names = ("a0_d1_p001_c1_color", "a39_d3_p118_c2_color", "a7_d8_p002_c2_color", "a12_d1_p119_c1")
    for name in names:
        write_uestc(folder / f"{name}.npz")
    motions = {item.path.stem: read(item) for item in scan([folder]).items}
    assert {name: (m.action, m.provenance.subject, m.split) for name, m in motions.items()} == {
        "a0_d1_p001_c1_color": ("punching-and-knee-lifting", "p001", "train"),
        "a39_d3_p118_c2_color": ("high-knees-running", "p118", "test"),
        "a7_d8_p002_c2_color": ("raising-hand-and-jumping", "p002", ""),
        "a12_d1_p119_c1": ("punching", "p119", ""),
    }
    assert {m.fps for m in motions.values()} == {Fraction(30)}
    assert len(set(ACTIONS)) == 40 and len(TRAIN_SUBJECTS) == 51


@pytest.mark.parametrize("view", [1, 6])
def test_every_view_is_turned_to_the_front_one(tmp_path: Path, view: int) -> None:
    trans = np.array([[0.0, 0.0, 0.0], [0.1, -0.2, 0.3], [0.2, -0.4, 0.6]], np.float32)
    front = read_uestc(write_uestc(tmp_path / f"a1_d{view}_p001_c1_color.npz", trans=trans))
    turn = Rotation.from_euler("y", 45.0 * view, degrees=True)
    seen = turn.apply(trans).astype(np.float32)
    side = read_uestc(write_uestc(tmp_path / f"a1_d{view}_p001_c2_color.npz", pose=pose(view=view), trans=seen))
    check_body(front)
    # It stands along +y and faces +z, its left at +x; the camera's right stays right, its down becomes down.
    body = map_joints(front, "smpl22")
    across = body[:, SMPL22.index("left_hip")] - body[:, SMPL22.index("right_hip")]
    assert (across[:, 0] > 0.1).all()
    assert np.allclose(front.joint_positions[2, 0] - front.joint_positions[0, 0], (0.2, 0.4, -0.6), atol=1e-6)
    assert not front.joint_positions[0, 0].any()
    toes = body[:, SMPL22.index("left_foot")] - body[:, SMPL22.index("left_ankle")]
    assert (toes[:, 2] > 0.1).all()
    assert np.allclose(side.joint_positions, front.joint_positions, atol=1e-5)


def test_the_documented_lines_make_files_that_are_read(tmp_path: Path) -> None:
    docs = (REPOSITORY / "docs" / "formats.md").read_text(encoding="utf-8")
    (lines,) = re.findall(r"```python\n(import pickle, pathlib.*?)```", docs, flags=re.DOTALL)
    (tmp_path / "info").mkdir()
    (tmp_path / "info" / "names.txt").write_text("a1_d1_p001_c1_color.avi\na2_d3_p003_c2_color.avi\n")
    (tmp_path / "vibe_cache_refined.pkl").write_bytes(pickle.dumps({"pose": [pose(4), pose(5)]}))
    (tmp_path / "globtrans_usez.pkl").write_bytes(pickle.dumps([np.ones((4, 3)), np.ones((5, 3))]))
    subprocess.run([sys.executable, "-W", "ignore", "-c", lines], cwd=tmp_path, check=True)
    motions = [read(item) for item in scan([tmp_path / "npz"]).items]
    assert [(m.action, m.num_frames) for m in motions] == [("marking-time-and-knee-lifting", 4), ("jumping-jack", 5)]


@pytest.mark.parametrize(
    ("name", "arrays", "reason"),
    [
        ("a40_d1_p001_c1", {}, "name"),
        ("a1_d1_p001_c1", {"pose": np.zeros((3, 71), np.float32)}, "channel-count"),
        ("a1_d1_p001_c1", {"trans": np.zeros((2, 3), np.float32)}, "channel-count"),
    ],
)
def test_bad_files_of_uestc_are_refused(tmp_path: Path, name: str, arrays: dict[str, np.ndarray], reason: str) -> None:
    assert refusal(read_uestc, write_uestc(tmp_path / f"{name}.npz", **arrays)).reason == reason


REAL_FRAMERATES = {"16": 2, "24": 4, "30": 5, "60": 9, "120": 53}


def standing(duration: float = 1 / 30) -> list[float]:
    """One frame: upright, the root at a height of 0.9 m."""
    frame = [duration, 0.0, 0.9, 0.0]
    for size in humanoid3d()[1]:
        frame += {4: [1.0, 0.0, 0.0, 0.0], 1: [0.0], 0: []}[size]
    return frame


def written(path: Path, frames: Any) -> Path:
    path.write_text(json.dumps({"Loop": "none", "Frames": frames}))
    return path


def test_a_bent_knee_and_a_turned_root_put_the_foot_where_geometry_says(tmp_path: Path) -> None:
    bent = standing()
    bent[20] = -np.pi / 2  # the right knee: duration, position, root, chest, neck and right hip come before it
    turned = standing()
    turned[4:8] = [np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0]
    motion = read_deepmimic(written(tmp_path / "humanoid3d_kick_a.txt", [standing(), bent, turned, standing(0.0)]))
    assert motion.fps == 30 and motion.num_frames == 4 and motion.action == "kick_a"
    ankle, wrist = motion.skeleton.index("right_ankle"), motion.skeleton.index("left_wrist")
    assert np.allclose(motion.joint_positions[0, ankle], (0.0, 0.9 - 0.421546 - 0.40987, 0.084887), atol=1e-6)
    # It faces +x, so a knee that bends takes the foot to −x.
    assert np.allclose(motion.joint_positions[1, ankle], (-0.40987, 0.9 - 0.421546, 0.084887), atol=1e-6)
    # A quarter turn about y takes its left (−z) to −x.
    x, y, z = motion.joint_positions[0, wrist]
    assert np.allclose(motion.joint_positions[2, wrist], (z, y, -x), atol=1e-6)


def test_every_real_clip_is_a_body_at_its_own_framerate(captures: Path) -> None:
    found = scan([captures / "deepmimic"])
    assert len(found.items) == 74 and not found.problems
    counts: dict[str, int] = {}
    for item in found.items:
        if item.path.stem == "humanoid3d_roll":
            assert (refusal(read, item).reason, refusal(read, item).frame) == ("frame-time", 5)
            continue
        motion = read(item)
        check_body(motion)
        counts[str(motion.fps)] = counts.get(str(motion.fps), 0) + 1
        assert -0.1 < motion.joint_positions[..., 1].min() < 0.1
        assert motion.action and motion.provenance.licence
    assert counts == REAL_FRAMERATES


@pytest.mark.parametrize(
    ("durations", "fps"),
    [
        ([0.033332, 0.033332, 0.0], Fraction(30)),
        ([0.0625, 0.0625, 9.0], Fraction(16)),
        ([1001 / 60000, 1001 / 60000, 0.0], Fraction(60000, 1001)),
    ],
)
def test_the_last_duration_says_nothing(tmp_path: Path, durations: list[float], fps: Fraction) -> None:
    motion = read_deepmimic(written(tmp_path / "m.txt", [standing(duration) for duration in durations]))
    assert motion.fps == fps and motion.provenance.stated_fps.startswith("2 × ")


FRAMES = [
    ([], "no-frames"),
    ([standing(), standing()[:-1]], "channel-count"),
    ([standing(), 1.0], "channel-count"),
    ([standing(-1.0), standing(-1.0), standing()], "frame-time"),
    ([standing(0.0)], "no-framerate"),
    ([standing(), ["1", *standing()[1:]]], "channel-count"),
    ([standing(), [float("nan"), *standing()[1:]]], "nan"),
    ([standing(), [*standing()[:2], 1e9, *standing()[3:]]], "range"),
    ([standing(), [*standing()[:4], 0.0, *standing()[5:]]], "range"),
    ({"0": standing()}, "not-what-it-says"),
]
CONTENTS = [(b'{"Loop": "w\xffrap", "Frames": []}', "encoding"), (b'{"Frames": ' + b"[" * 100_000, "not-what-it-says")]


@pytest.mark.parametrize(
    ("content", "reason"), [*((json.dumps({"Frames": frames}).encode(), why) for frames, why in FRAMES), *CONTENTS]
)
def test_bad_files_of_deepmimic_are_refused(tmp_path: Path, content: bytes, reason: str) -> None:
    (tmp_path / "m.txt").write_bytes(content)
    assert refusal(read_deepmimic, tmp_path / "m.txt").reason == reason
