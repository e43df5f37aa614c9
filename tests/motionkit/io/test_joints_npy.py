from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from motionkit.core import kinematics
from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.io.joints_npy import read_humanact12, read_joints_npy, write_joints_npy
from motionkit.io.registry import ReadOptions
from motionkit.io.scan import read, scan
from tests.helpers.refusal import refusal


def standing(num_frames: int = 5, num_joints: int = 22) -> np.ndarray:
    rotations = np.zeros((num_frames, 22, 4), np.float32)
    rotations[..., 0] = 1.0
    root = np.tile(np.array([0, 0.93, 0], np.float32), (num_frames, 1))
    positions = kinematics.forward_kinematics(rotations, root, SMPL22)
    return np.concatenate((positions, positions[:, : num_joints - 22]), axis=1)


def test_round_trip_with_its_framerate(tmp_path: Path) -> None:
    motion = Motion(standing(), SMPL22, TimeGrid(Fraction(30000, 1001), 5))
    write_joints_npy(motion, tmp_path / "a.npy")
    (item,) = scan([tmp_path]).items
    again = read(item)
    assert again.fps == Fraction(30000, 1001) and again.provenance.stated_fps == "30000/1001"
    assert np.array_equal(again.joint_positions, motion.joint_positions)
    with pytest.raises(ValueError, match=r"motions\.json"):
        write_joints_npy(Motion(standing(), SMPL22, TimeGrid(Fraction(60), 5)), tmp_path / "b.npy")


def test_without_a_framerate_it_says_how_to_give_one(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", standing())
    assert refusal(read_joints_npy, tmp_path / "a.npy").reason == "no-framerate"
    assert read_joints_npy(tmp_path / "a.npy", ReadOptions(fps=Fraction(24))).fps == 24


@pytest.mark.parametrize("turn", ["z up", "y down"])
def test_bodies_are_turned_upright_and_left_stays_left(tmp_path: Path, turn: str) -> None:
    body = standing()
    x, y, z = np.moveaxis(body, -1, 0)
    np.save(tmp_path / "a.npy", np.stack((x, -z, y) if turn == "z up" else (x, -y, -z), axis=-1))
    motion = read_joints_npy(tmp_path / "a.npy", ReadOptions(fps=Fraction(24)))
    assert np.allclose(motion.joint_positions, body, atol=1e-6)


def test_humanact12_clips_are_known_by_name_and_shape(tmp_path: Path) -> None:
    np.save(tmp_path / "P03G01R02F0069T0143A0402.npy", standing(num_joints=24))
    (item,) = scan([tmp_path]).items
    motion = read(item)
    assert (item.format, motion.fps, motion.action, motion.provenance.subject) == ("humanact12", 20, "jump", "03")
    assert motion.joint_positions.shape == (5, 22, 3)
    at_15 = read_humanact12(item.path, ReadOptions(fps=Fraction(15)))
    assert at_15.fps == 15 and at_15.provenance.stated_fps == "20"


@pytest.mark.parametrize("shape", [(4, 20, 3), (4, 22, 2), (0, 22, 3)])
def test_other_shapes_are_refused(tmp_path: Path, shape: tuple[int, ...]) -> None:
    np.save(tmp_path / "a.npy", np.zeros(shape, np.float32))
    refusal(read_joints_npy, tmp_path / "a.npy", ReadOptions(fps=Fraction(24)))


@pytest.mark.parametrize("manifest", ["[]", "{", '{"fps": 0}', '{"layout": "dog"}', '{"fps": null, "unit_metres": -1}'])
def test_a_bad_manifest_is_refused(tmp_path: Path, manifest: str) -> None:
    np.save(tmp_path / "a.npy", standing())
    (tmp_path / "motions.json").write_text(manifest)
    assert refusal(read_joints_npy, tmp_path / "a.npy", ReadOptions(fps=Fraction(24))).reason == "manifest"
