from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from motionkit.core import kinematics
from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.io.bvh.document import read_bvh
from motionkit.io.bvh.writing import write_bvh
from motionkit.io.registry import ReadOptions
from tests.helpers.format_samples import bvh_text


def test_positions_rotations_and_framerate(tmp_path: Path) -> None:
    path = tmp_path / "walk.bvh"
    path.write_text(bvh_text())
    motion = read_bvh(path)
    assert motion.fps == Fraction(30) and motion.num_frames == 4
    assert motion.provenance.stated_fps == "Frame Time: 0.0333333"
    hand, elbow = motion.skeleton.index("LeftHand"), motion.skeleton.index("LeftForeArm")
    assert np.allclose(motion.joint_positions[3, 0], (0, 0.95, 0.06))
    assert np.allclose(motion.joint_positions[0, hand], (0.72, 1.42, 0.0), atol=1e-6)
    bend = np.radians(30)
    forearm = motion.joint_positions[3, hand] - motion.joint_positions[3, elbow]
    assert np.allclose(forearm, (0.26 * np.cos(bend), 0.26 * np.sin(bend), 0.0), atol=1e-6)
    assert motion.local_rotations is not None and motion.root_translation is not None
    again = kinematics.forward_kinematics(motion.local_rotations, motion.root_translation, motion.skeleton)
    assert np.allclose(again, motion.joint_positions, atol=1e-6)


@pytest.mark.parametrize("pattern", ["cmu/bvh/*.bvh", "cmu/bvh-converted/*.bvh", "mixed-bvh/*/*.bvh"])
def test_every_real_file_is_a_metre_sized_upright_body(captures: Path, pattern: str) -> None:
    for path in sorted(captures.glob(pattern)):
        motion = read_bvh(path)
        heads = motion.joint_positions[:, motion.skeleton.joint_names.index(_head(motion.skeleton.joint_names)), 1]
        assert 0.9 < np.median(heads) < 2.2, path.name


def _head(names: tuple[str, ...]) -> str:
    return next(name for name in names if name.lower().endswith("head"))


def test_the_t_pose_of_the_cmu_conversions_is_dropped_and_no_other_frame(captures: Path) -> None:
    for folder, dropped in (("bvh", True), ("bvh-converted", False)):
        for path in sorted((captures / "cmu" / folder).glob("*.bvh")):
            operations = " ".join(read_bvh(path).provenance.operations)
            assert ("T-pose" in operations) == dropped, path.name


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    (tmp_path / "in.bvh").write_text(bvh_text(frame_time=".0083333"))
    motion = read_bvh(tmp_path / "in.bvh")
    write_bvh(motion, tmp_path / "out.bvh")
    again = read_bvh(tmp_path / "out.bvh")
    assert again.fps == motion.fps == 120
    assert again.skeleton.joint_names == motion.skeleton.joint_names
    for (joint, tip), (joint_again, tip_again) in zip(motion.skeleton.end_sites, again.skeleton.end_sites, strict=True):
        assert joint == joint_again and tip == pytest.approx(tip_again)
    assert np.allclose(again.joint_positions, motion.joint_positions, atol=1e-5)
    assert again.local_rotations is not None and motion.local_rotations is not None
    assert np.allclose(np.abs(np.sum(again.local_rotations * motion.local_rotations, axis=-1)), 1.0, atol=1e-6)


@pytest.mark.parametrize(("change_metres", "misses_metres"), [(0.0, 1e-4), (3e-4, 2e-3)])
def test_bones_that_keep_their_length_need_no_position_channels(
    tmp_path: Path, change_metres: float, misses_metres: float
) -> None:
    """Whatever shape the body's own hips and shoulders have; bones that change a little are written as one skeleton."""
    rng = np.random.default_rng(3)
    offsets = SMPL22.offsets + rng.normal(0, 0.03, SMPL22.offsets.shape).astype(np.float32)
    turns = Rotation.random(50 * 22, rng).as_quat(scalar_first=True).reshape(50, 22, 4).astype(np.float32)
    root = rng.normal(size=(50, 3)).astype(np.float32)
    positions = kinematics.forward_kinematics(turns, root, replace(SMPL22, offsets=offsets))
    positions = (positions + rng.uniform(-change_metres, change_metres, positions.shape)).astype(np.float32)
    write_bvh(Motion(positions, SMPL22, TimeGrid(Fraction(60), 50)), tmp_path / "own.bvh")
    text = (tmp_path / "own.bvh").read_text()
    assert (text.count("CHANNELS 6"), text.count("CHANNELS 3")) == (1, 21)
    again = read_bvh(tmp_path / "own.bvh")
    order = [again.skeleton.index(joint) for joint in SMPL22.joint_names]
    assert np.abs(again.joint_positions[:, order] - positions).max() < misses_metres


def test_rotations_in_gimbal_lock_come_back(tmp_path: Path) -> None:
    """A root that pitches by exactly 90 degrees in many headings, as float32 holds it."""
    turns = np.zeros((60, 22, 4))
    turns[..., 0] = 1.0
    turns[:, 0] = Rotation.from_euler("ZXY", [[0, 90, 6 * k] for k in range(60)], degrees=True).as_quat(
        scalar_first=True
    )
    turns = turns.astype(np.float32)
    root = np.zeros((60, 3), np.float32)
    motion = Motion(kinematics.forward_kinematics(turns, root, SMPL22), SMPL22, TimeGrid(Fraction(60), 60), turns, root)
    write_bvh(motion, tmp_path / "out.bvh")
    again = read_bvh(tmp_path / "out.bvh", ReadOptions(up="y"))
    order = [again.skeleton.index(joint) for joint in SMPL22.joint_names]
    np.testing.assert_allclose(again.joint_positions[:, order], motion.joint_positions, atol=1e-4)


@pytest.mark.parametrize("fps", [Fraction(20), Fraction(30000, 1001), Fraction(25, 2), Fraction(250)])
def test_positions_without_rotations_are_written_exactly(tmp_path: Path, fps: Fraction) -> None:
    rng = np.random.default_rng(0)
    turns = Rotation.random(30 * 22, rng).as_quat(scalar_first=True).reshape(30, 22, 4).astype(np.float32)
    root = rng.normal(size=(30, 3)).astype(np.float32)
    positions = kinematics.forward_kinematics(turns, root, SMPL22)
    for name, joints in (("rigid", positions), ("loose", positions + rng.normal(0, 0.01, positions.shape))):
        motion = Motion(joints.astype(np.float32), SMPL22, TimeGrid(fps, 30))
        write_bvh(motion, tmp_path / f"{name}.bvh")
        again = read_bvh(tmp_path / f"{name}.bvh")
        order = [again.skeleton.index(joint) for joint in SMPL22.joint_names]
        assert again.fps == fps
        assert np.abs(again.joint_positions[:, order] - motion.joint_positions).max() < 1.5e-4
        assert (again.local_rotations is None) == (name == "loose")
