"""Euler angles that go on from known ones: the rotations wanted, no turn that is not one, anchors left alone."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from motionkit.core.kinematics import euler_to_quaternion
from motionkit.io.bvh.channels import anchored_angles

ORDERS = ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX", "ZXZ", "XYX", "YZY")
EVERY = 4


def path(seed: int, num_frames: int, speed: float) -> np.ndarray:
    """Rotations of one joint that turns steadily about a slowly turning axis, [frames, 1, 4]."""
    rng = np.random.default_rng(seed)
    steps = Rotation.from_rotvec(speed * rng.normal(size=3) + 0.3 * speed * rng.normal(size=(num_frames, 3)))
    rotation, result = Rotation.random(rng=rng), []
    for step in steps:
        rotation = step * rotation
        result.append(rotation.as_quat(scalar_first=True))
    return np.array(result)[:, None]


def followed(rotations: np.ndarray, order: str, anchors: np.ndarray) -> np.ndarray:
    """Angles of all rows, every fourth of which is an anchor."""
    after = np.arange(len(rotations)) // EVERY
    expected = np.zeros((len(rotations), 1, len(order)))
    return anchored_angles(rotations, order, expected, anchors, after)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), order=st.sampled_from(ORDERS), turns=st.integers(-2, 2), other=st.booleans())
def test_angles_turn_as_wanted_and_stay_near_their_anchors(seed: int, order: str, turns: int, other: bool) -> None:
    rotations = path(seed, 40, 0.02)
    known = Rotation.from_quat(rotations[::EVERY, 0], scalar_first=True).as_euler(order)
    if other:
        flip = np.array([np.pi, -1, np.pi])
        second = -known[:, 1] if order[0] == order[2] else np.pi - known[:, 1]
        known = np.stack((known[:, 0] + flip[0], second, known[:, 2] + flip[2]), axis=1)
    anchors = np.degrees(known + 2 * np.pi * turns)[:, None]
    found = followed(rotations, order, anchors)
    again = euler_to_quaternion(np.radians(found), order)
    assert np.abs(np.sum(again * rotations, axis=-1)).min() > 1 - 1e-9
    np.testing.assert_allclose(found[::EVERY], anchors, atol=1e-3)
    # Far from the pole no angle moves much more than the body turns.
    pole = np.sin if order[0] == order[2] else np.cos
    safe = np.abs(pole(np.radians(found[:, 0, 1]))) > 0.5
    steps = np.abs(np.diff(found[:, 0], axis=0)).max(axis=-1)[safe[1:] & safe[:-1]]
    within = np.arange(1, 40) % EVERY != 0
    assert (steps[within[safe[1:] & safe[:-1]]] < 30).all()


def test_a_joint_that_spins_goes_on_beyond_half_a_turn() -> None:
    angles = np.linspace(0, 720, 91)[:, None, None] * np.array([0.0, 0.0, 1.0])
    rotations = euler_to_quaternion(np.radians(angles), "ZXY")
    found = anchored_angles(rotations, "ZXY", angles * 0 + 7.0, angles[:1], np.zeros(91, np.int64))
    np.testing.assert_allclose(found, angles, atol=1e-6)


def test_a_joint_at_the_pole_keeps_its_angles() -> None:
    """At 90° only the sum of the outer angles is a rotation: they stay at what is expected."""
    angles = np.broadcast_to(np.array([20.0, 90.0, -35.0]), (8, 1, 3))
    rotations = euler_to_quaternion(np.radians(angles), "ZXY").astype(np.float32).astype(np.float64)
    found = anchored_angles(rotations, "ZXY", np.array(angles), np.array(angles[:1]), np.zeros(8, np.int64))
    np.testing.assert_array_equal(found, np.degrees(np.radians(angles)))


@pytest.mark.parametrize("order", ["X", "Z", "XY", "ZX"])
def test_joints_of_fewer_axes_use_those_they_have(order: str) -> None:
    rng = np.random.default_rng(1)
    angles = np.cumsum(rng.uniform(-4, 4, (50, 3, len(order))), axis=0)
    rotations = euler_to_quaternion(np.radians(angles), order)
    found = anchored_angles(rotations, order, np.zeros_like(angles), angles[:1], np.zeros(50, np.int64))
    np.testing.assert_allclose(found, angles, atol=1e-6)
