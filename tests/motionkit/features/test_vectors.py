"""Native, field and rotation vectors: what they mean, round trips, frames and mirrors."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

import motionkit as mk
from motionkit.core import kinematics
from motionkit.core.kinematics import forward_kinematics
from motionkit.core.motion import mirror
from motionkit.core.skeletons.mapping import SkeletonMapError, rest_positions
from motionkit.features import field, humanml3d, native, rotations
from motionkit.features.layout import LAYOUTS, SMPL22_LAYOUT
from motionkit.fields.motion_field import Poses
from tests.helpers.nerm_corpus import analytic_positions

SECONDS = 5
PART = SMPL22_LAYOUT.vector


def analytic_motion(fps: Fraction, name: str = "smpl22", scale: float = 1.0, walk: float = 1.0) -> np.ndarray:
    """A smooth motion as a formula of time, up to 1.5 Hz: joints sway, the body turns by more than π and walks."""
    body = LAYOUTS[name]
    rng = np.random.default_rng(0)
    t = (np.arange(int(SECONDS * fps) + 1) / float(fps))[:, None, None]
    identity = np.tile(np.array([1.0, 0, 0, 0]), (1, body.num_joints, 1))
    rest = forward_kinematics(identity, np.array([[0, 0.9, 0]]), body.skeleton)
    hertz, phase = rng.uniform(0.2, 1.5, (body.num_joints, 3)), rng.uniform(0, 6, (body.num_joints, 3))
    joints = rest + 0.03 * np.sin(2 * np.pi * hertz * t + phase)
    yaw = 1.2 * t[..., 0] + 0.4 * np.sin(2 * t[..., 0])
    x, z = joints[..., 0].copy(), joints[..., 2].copy()
    joints[..., 0] = np.cos(yaw) * x + np.sin(yaw) * z + 0.8 * walk * t[..., 0]
    joints[..., 2] = np.cos(yaw) * z - np.sin(yaw) * x + walk * np.sin(1.3 * t[..., 0])
    return (scale * joints).astype(np.float32)


@pytest.mark.parametrize("fps", [20, 60, 120])
def test_vectors_mean_the_same_at_every_framerate(fps: int) -> None:
    stride, fine_stride = fps // 10, 25
    found = native.vectors(analytic_motion(Fraction(fps)), "smpl22", Fraction(fps))[::stride]
    fine = native.vectors(analytic_motion(Fraction(250)), "smpl22", Fraction(250))[::fine_stride]
    assert found.shape == fine.shape == (10 * SECONDS + 1, 263)
    difference = np.abs(found - fine)
    inside = slice(2, -2)  # instants next to the ends have a one-sided derivative
    for block, tolerance in zip(PART, (2e-4, 5e-4, 1e-6, 1e-4, 2e-4, 5e-4), strict=False):
        assert difference[inside, block].max() < tolerance
    assert np.mean(found[:, PART.contacts] != fine[:, PART.contacts]) < 0.02


def test_velocities_are_the_formula_s_derivative() -> None:
    fps = Fraction(60)
    found = native.vectors(analytic_motion(fps), "smpl22", fps)
    fine = analytic_motion(Fraction(6000)).astype(np.float64)
    middle = np.arange(100, SECONDS * 6000, 100)
    speed = np.linalg.norm(fine[middle + 10] - fine[middle - 10], axis=-1) * 300
    velocities = found[1:-1, PART.joint_velocities].reshape(-1, 22, 3)
    assert np.allclose(np.linalg.norm(velocities, axis=-1), speed, atol=2e-3)
    contacts = found[1:-1, PART.contacts].astype(bool)
    feet = speed[:, list(SMPL22_LAYOUT.contact_joints)]
    assert np.all(contacts[np.abs(feet - 0.894) > 0.01] == (feet < 0.894)[np.abs(feet - 0.894) > 0.01])


@pytest.mark.parametrize("name", list(LAYOUTS))
@pytest.mark.parametrize("fps", [20, 120])
def test_positions_come_back_up_to_place_and_facing(name: str, fps: int) -> None:
    joints = analytic_motion(Fraction(fps), name)
    found = native.positions_at(native.vectors(joints, name, Fraction(fps)), name, np.arange(len(joints)) / fps)
    assert np.allclose(found[0, 0, [0, 2]], 0)
    # A rigid motion of the horizontal plane between the two, found from the first pose.
    flat, target = (p[..., 0] + 1j * p[..., 2] for p in (found, joints))
    turn = np.vdot(flat[0] - flat[0, 0], target[0] - target[0, 0])
    placed = (flat - flat[0, 0]) * turn / abs(turn) + target[0, 0]
    assert np.abs(placed - target).max() < (0.02 if fps == 20 else 1e-3)
    assert np.allclose(found[..., 1], joints[..., 1], atol=1e-6)


def test_a_steady_turn_has_its_rate_which_is_that_of_the_turn_to_z() -> None:
    rest = analytic_motion(Fraction(1))[0]
    yaw = 1.2 * np.arange(241)[:, None] / 20
    joints = np.stack(
        (
            np.cos(yaw) * rest[:, 0] + np.sin(yaw) * rest[:, 2],
            np.broadcast_to(rest[:, 1], (241, 22)),
            np.cos(yaw) * rest[:, 2] - np.sin(yaw) * rest[:, 0],
        ),
        axis=-1,
    ).astype(np.float32)
    found = native.vectors(joints, "smpl22", Fraction(20))
    assert found[120, 0] == pytest.approx(-1.2, abs=1e-3)
    # The published number is half the angle per frame.
    assert 2 * 20 * humanml3d.vectors(joints, "smpl22")[120, 0] == pytest.approx(-1.2, abs=1e-2)
    # A body that turns as one keeps its pose, so every row is the same but for contacts at the threshold.
    assert np.allclose(found[110:130, PART.joint_rotations], found[120, PART.joint_rotations], atol=1e-3)


def test_contacts_do_not_depend_on_the_unit() -> None:
    fps = Fraction(25, 2)
    pair = [native.vectors(analytic_motion(fps, "kit21", unit, 0.3), "kit21", fps)[:, 247:] for unit in (1.0, 1000.0)]
    assert np.array_equal(*pair) and 0.05 < pair[0].mean() < 0.95


coordinates = st.floats(-5, 5, width=32)
windows = arrays(np.float32, (2, 3, 22, 3), elements=coordinates)


def standing_bodies(rng: np.random.Generator, num_windows: int, num_poses: int) -> np.ndarray:
    """Bodies with jittered joints, so that facing is well defined, walking away from a random place."""
    jitter = rng.normal(scale=0.03, size=(num_windows, num_poses, 22, 3))
    path = rng.normal(size=(num_windows, 1, 1, 3)) + 0.02 * np.arange(num_poses)[None, :, None, None]
    return (rest_positions(mk.SMPL22) + jitter + path).astype(np.float32)


def turned(positions: np.ndarray, yaw: float, shift: tuple[float, float]) -> np.ndarray:
    rotated = Rotation.from_rotvec([0, yaw, 0]).apply(positions.reshape(-1, 3)).reshape(positions.shape)
    return (rotated + np.array([shift[0], 0.0, shift[1]])).astype(np.float32)


@given(windows)
def test_round_trip_through_the_window(positions: np.ndarray) -> None:
    yaw, origin = field.window_frame(positions[:, 0])
    local = field.decode(field.encode(positions, yaw, origin))
    assert np.allclose(local, field.to_window(positions, yaw, origin), atol=1e-5)


@given(st.integers(0, 2**32 - 1), st.floats(-7, 7), st.tuples(st.floats(-3, 3), st.floats(-3, 3)))
def test_turning_and_moving_the_world_changes_nothing(seed: int, yaw: float, shift: tuple[float, float]) -> None:
    positions = standing_bodies(np.random.default_rng(seed), 2, 4)
    moved = turned(positions, yaw, shift)
    vectors = field.encode(positions, *field.window_frame(positions[:, 0]))
    assert np.allclose(field.encode(moved, *field.window_frame(moved[:, 0])), vectors, atol=5e-6)


def test_the_window_starts_at_the_origin_and_faces_z() -> None:
    positions = turned(standing_bodies(np.random.default_rng(0), 3, 5), 2.0, (4.0, -1.0))
    vectors = field.encode(positions, *field.window_frame(positions[:, 0]))
    local = field.decode(vectors)
    assert vectors.shape == (3, 5, 66)
    assert np.allclose(local[:, 0, 0, [0, 2]], 0.0, atol=1e-6)
    assert np.allclose(vectors[:, :, 1], positions[:, :, 0, 1])
    assert np.allclose(field.heading(local[:, 0]), 0.0, atol=1e-6)


def random_rotations(seed: int, *shape: int) -> np.ndarray:
    q = np.random.default_rng(seed).normal(size=(*shape, 4))
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def moving(num_frames: int = 30) -> mk.Motion:
    grid = mk.TimeGrid(Fraction(30), num_frames)
    return mk.Motion(analytic_positions(grid.seconds(), 1), mk.SMPL22, grid)


def test_positions_without_rotations_come_back_exactly() -> None:
    motion = moving()
    found = rotations.rotation_rows(motion)
    assert found.vectors.shape == (30, 135) and found.skeleton == mk.SMPL22
    np.testing.assert_allclose(found.poses().joint_positions, motion.joint_positions, atol=2e-6)


@pytest.fixture
def rotating() -> mk.Motion:
    """Eight poses with random rotations of all joints."""
    q = random_rotations(1, 8, 22).astype(np.float32)
    root = np.random.default_rng(2).normal(size=(8, 3)).astype(np.float32)
    positions = kinematics.forward_kinematics(q, root, mk.SMPL22)
    return mk.Motion(positions, mk.SMPL22, mk.TimeGrid(Fraction(30), 8), local_rotations=q, root_translation=root)


def test_true_rotations_are_kept(rotating: mk.Motion) -> None:
    poses = rotations.rotation_rows(rotating).poses()
    assert poses.local_rotations is not None and rotating.local_rotations is not None
    alike = np.abs(np.sum(poses.local_rotations * rotating.local_rotations, axis=-1))
    np.testing.assert_allclose(alike, 1.0, atol=1e-5)
    np.testing.assert_allclose(poses.joint_positions, rotating.joint_positions, atol=5e-6)


def test_other_skeletons_keep_their_joints_or_are_mapped() -> None:
    grid = mk.TimeGrid(Fraction(30), 2)
    still = np.repeat(rest_positions(mk.KIT21)[None], 2, axis=0)
    assert rotations.rows_of_poses(Poses(still), mk.KIT21).vectors.shape == (2, 3 + 6 * 21)
    unknown = mk.Skeleton("two", ("a", "b"), (-1, 0), np.zeros((2, 3), np.float32))
    with pytest.raises(SkeletonMapError):
        rotations.rotation_rows(mk.Motion(still[:, :2], unknown, grid))


@given(seed=st.integers(0, 2**31))
def test_world_and_window_are_inverse_and_turn_the_heading(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vectors = np.concatenate(
        (rng.normal(size=(2, 7, 3)), kinematics.two_columns(random_rotations(seed, 2, 7, 22))), axis=-1
    )
    vectors = vectors.astype(np.float32)
    yaw, origin = rng.uniform(-3, 3, 2), rng.normal(size=(2, 2))
    inside = rotations.to_window(vectors, yaw, origin)
    np.testing.assert_allclose(rotations.to_world(inside, yaw, origin), vectors, atol=2e-6)
    change = rotations.heading(inside) - (rotations.heading(vectors) - yaw[:, None])
    np.testing.assert_allclose(np.cos(change), 1.0, atol=1e-5)
    # Heights and the joints below the root do not change.
    np.testing.assert_array_equal(inside[..., [1, *range(9, 135)]], vectors[..., [1, *range(9, 135)]])


def test_mirrored_rows_are_the_mirrored_motion(rotating: mk.Motion) -> None:
    expected = rotations.rotation_rows(mirror(rotating)).vectors
    vectors = rotations.rotation_rows(rotating).vectors
    np.testing.assert_allclose(rotations.mirrored(vectors), expected, atol=1e-6)
    np.testing.assert_array_equal(rotations.mirrored(rotations.mirrored(vectors)), vectors)
