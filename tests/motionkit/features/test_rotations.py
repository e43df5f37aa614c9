"""Rotation rows: round trips, frames, mirrors, and columns that are no rotation."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from motionkit.core import kinematics
from motionkit.core.motion import Motion, mirror
from motionkit.core.skeleton import KIT21, SMPL22, Skeleton
from motionkit.core.skeletons.mapping import SkeletonMapError, rest_positions
from motionkit.core.timegrid import TimeGrid
from motionkit.features import rotations
from motionkit.fields.motion_field import Poses
from tests.helpers.nerm_corpus import analytic_positions


def random_rotations(seed: int, *shape: int) -> np.ndarray:
    q = np.random.default_rng(seed).normal(size=(*shape, 4))
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def moving(num_frames: int = 30) -> Motion:
    grid = TimeGrid(Fraction(30), num_frames)
    return Motion(analytic_positions(grid.seconds(), 1), SMPL22, grid)


def test_positions_without_rotations_come_back_exactly() -> None:
    motion = moving()
    found = rotations.rotation_rows(motion)
    assert found.vectors.shape == (30, 135) and found.skeleton == SMPL22
    np.testing.assert_allclose(found.poses().joint_positions, motion.joint_positions, atol=2e-6)


@pytest.fixture
def rotating() -> Motion:
    """Eight poses with random rotations of all joints."""
    q = random_rotations(1, 8, 22).astype(np.float32)
    root = np.random.default_rng(2).normal(size=(8, 3)).astype(np.float32)
    positions = kinematics.forward_kinematics(q, root, SMPL22)
    return Motion(positions, SMPL22, TimeGrid(Fraction(30), 8), local_rotations=q, root_translation=root)


def test_true_rotations_are_kept(rotating: Motion) -> None:
    poses = rotations.rotation_rows(rotating).poses()
    assert poses.local_rotations is not None and rotating.local_rotations is not None
    alike = np.abs(np.sum(poses.local_rotations * rotating.local_rotations, axis=-1))
    np.testing.assert_allclose(alike, 1.0, atol=1e-5)
    np.testing.assert_allclose(poses.joint_positions, rotating.joint_positions, atol=5e-6)


def test_other_skeletons_keep_their_joints_or_are_mapped() -> None:
    grid = TimeGrid(Fraction(30), 2)
    still = np.repeat(rest_positions(KIT21)[None], 2, axis=0)
    assert rotations.rows_of_poses(Poses(still), KIT21).vectors.shape == (2, 3 + 6 * 21)
    unknown = Skeleton("two", ("a", "b"), (-1, 0), np.zeros((2, 3), np.float32))
    with pytest.raises(SkeletonMapError):
        rotations.rotation_rows(Motion(still[:, :2], unknown, grid))


@given(seed=st.integers(0, 2**31))
def test_world_and_window_are_inverse_and_turn_the_heading(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vectors = np.concatenate(
        (rng.normal(size=(2, 7, 3)), rotations.two_columns(random_rotations(seed, 2, 7, 22))), axis=-1
    )
    vectors = vectors.astype(np.float32)
    yaw, origin = rng.uniform(-3, 3, 2), rng.normal(size=(2, 2))
    inside = rotations.to_window(vectors, yaw, origin)
    np.testing.assert_allclose(rotations.to_world(inside, yaw, origin), vectors, atol=2e-6)
    change = rotations.heading(inside) - (rotations.heading(vectors) - yaw[:, None])
    np.testing.assert_allclose(np.cos(change), 1.0, atol=1e-5)
    # Heights and the joints below the root do not change.
    np.testing.assert_array_equal(inside[..., [1, *range(9, 135)]], vectors[..., [1, *range(9, 135)]])


def test_mirrored_rows_are_the_mirrored_motion(rotating: Motion) -> None:
    expected = rotations.rotation_rows(mirror(rotating)).vectors
    vectors = rotations.rotation_rows(rotating).vectors
    np.testing.assert_allclose(rotations.mirrored(vectors), expected, atol=1e-6)
    np.testing.assert_array_equal(rotations.mirrored(rotations.mirrored(vectors)), vectors)
