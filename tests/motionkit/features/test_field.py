import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import rest_positions
from motionkit.features import field

coordinates = st.floats(-5, 5, width=32)
windows = arrays(np.float32, (2, 3, 22, 3), elements=coordinates)


def standing_bodies(rng: np.random.Generator, num_windows: int, num_poses: int) -> np.ndarray:
    """Bodies with jittered joints, so that facing is well defined, walking away from a random place."""
    jitter = rng.normal(scale=0.03, size=(num_windows, num_poses, 22, 3))
    path = rng.normal(size=(num_windows, 1, 1, 3)) + 0.02 * np.arange(num_poses)[None, :, None, None]
    return (rest_positions(SMPL22) + jitter + path).astype(np.float32)


def turned(positions: np.ndarray, yaw: float, shift: tuple[float, float]) -> np.ndarray:
    rotated = Rotation.from_rotvec([0, yaw, 0]).apply(positions.reshape(-1, 3)).reshape(positions.shape)
    return (rotated + np.array([shift[0], 0.0, shift[1]])).astype(np.float32)


@given(windows)
def test_round_trip_through_the_window_and_the_world(positions: np.ndarray) -> None:
    yaw, origin = field.window_frame(positions[:, 0])
    local = field.decode(field.encode(positions, yaw, origin))
    assert np.allclose(local, field.to_window(positions, yaw, origin), atol=1e-5)
    assert np.allclose(field.to_world(local, yaw, origin), positions, atol=1e-5)


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
