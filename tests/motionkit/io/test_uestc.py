"""UESTC sequences converted from ACTOR's pickle: names, views, frames of reference; and the pickle itself."""

import pickle
import re
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import map_joints
from motionkit.io.scan import read, scan
from motionkit.io.uestc import ACTIONS, TRAIN_SUBJECTS, read_uestc
from tests.helpers.bones import check_body
from tests.helpers.refusal import refusal
from tests.helpers.repository import REPOSITORY


def pose(num_frames: int = 3, view: int = 0) -> np.ndarray:
    """Standing before a camera (y down, z away) and facing the front one, seen by the camera of a view."""
    poses = np.zeros((num_frames, 72), np.float32)
    seen = Rotation.from_euler("y", 45.0 * view, degrees=True) * Rotation.from_rotvec([np.pi, 0.0, 0.0])
    poses[:, :3] = seen.as_rotvec()
    return poses


def write(path: Path, **arrays: np.ndarray) -> Path:
    np.savez(path, **({"pose": pose()} | arrays))
    return path


def test_names_say_action_subject_and_set(tmp_path: Path) -> None:
    folder = tmp_path / "uestc"
    folder.mkdir()
    names = ("a0_d1_p001_c1_color", "a39_d3_p118_c2_color", "a7_d8_p002_c2_color", "a12_d1_p119_c1")
    for name in names:
        write(folder / f"{name}.npz")
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
    front = read_uestc(write(tmp_path / f"a1_d{view}_p001_c1_color.npz", trans=trans))
    turn = Rotation.from_euler("y", 45.0 * view, degrees=True)
    seen = turn.apply(trans).astype(np.float32)
    side = read_uestc(write(tmp_path / f"a1_d{view}_p001_c2_color.npz", pose=pose(view=view), trans=seen))
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
def test_bad_files_are_refused(tmp_path: Path, name: str, arrays: dict[str, np.ndarray], reason: str) -> None:
    assert refusal(read_uestc, write(tmp_path / f"{name}.npz", **arrays)).reason == reason
