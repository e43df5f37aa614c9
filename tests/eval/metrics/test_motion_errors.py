"""Derivative errors, foot skating, contacts and bone lengths: analytic motion, loops over frames, refusals."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from eval.metrics.motion import (
    acceleration_error,
    jerk_error,
    rotation_angle_error,
    skating_speed,
    velocity_error,
)

ERRORS = (velocity_error, acceleration_error, jerk_error)


def seconds(fps: float, duration: float = 2.0) -> np.ndarray:
    return np.arange(int(duration * fps) + 1) / fps


@pytest.mark.parametrize("fps", [20.0, 60.0, 120.0])
def test_a_cubic_has_its_own_derivatives_at_every_framerate(fps: float) -> None:
    time = seconds(fps)
    target = np.zeros((len(time), 2, 3))
    predicted = target.copy()
    predicted[:, 0, 1] = 0.5 * time**3
    # Two joints, one of them right. Finite differences of a cubic: the third is exact, the others tend to the mean.
    assert jerk_error(predicted, target, fps) == pytest.approx(3.0 / 2, rel=1e-6)
    assert velocity_error(predicted, target, fps) == pytest.approx(0.5 * 2.0**3 / 2.0 / 2, rel=1e-9)
    predicted[:, 0, 1] = 0.5 * time**2
    assert acceleration_error(predicted, target, fps) == pytest.approx(1.0 / 2, rel=1e-8)


def test_derivative_errors_agree_with_loops_over_both_motions() -> None:
    rng = np.random.default_rng(0)
    predicted, target = rng.normal(size=(2, 9, 4, 3))

    def derivative(motion: np.ndarray, order: int) -> list[np.ndarray]:
        values = list(motion)
        for _ in range(order):
            values = [(after - before) * 25.0 for before, after in pairwise(values)]
        return values

    for order, error in enumerate(ERRORS, start=1):
        pairs = zip(derivative(predicted, order), derivative(target, order), strict=True)
        expected = np.mean([np.sqrt(((a[j] - b[j]) ** 2).sum()) for a, b in pairs for j in range(4)])
        assert error(predicted, target, 25.0) == pytest.approx(expected, rel=1e-12)


def test_rotation_error_is_the_angle_between_whatever_the_signs() -> None:
    rng = np.random.default_rng(5)
    target = Rotation.random(60, random_state=rng)
    axis = rng.normal(size=(60, 3))
    angle = np.concatenate(([1e-7, np.pi], rng.uniform(0, np.pi, 58)))
    turn = Rotation.from_rotvec(angle[:, None] * axis / np.linalg.norm(axis, axis=1, keepdims=True))
    signs = rng.choice([-1.0, 1.0], size=(60, 1))
    for k in range(60):
        predicted = (signs * (target * turn).as_quat())[k].reshape(1, 1, 4)
        found = rotation_angle_error(predicted, target.as_quat()[k].reshape(1, 1, 4))
        assert found == pytest.approx(np.degrees(angle[k]), rel=1e-6)
    with pytest.raises(ValueError, match="predicted: quaternions must have unit length"):
        rotation_angle_error(np.full((1, 1, 4), 0.4), np.array([[[1.0, 0, 0, 0]]]))


def sliding_feet(fps: float, height: float, speed: float) -> np.ndarray:
    feet = np.zeros((len(seconds(fps)), 4, 3))
    feet[..., 1] = height
    feet[:, 0, 0] = 0.6 * speed * seconds(fps)
    feet[:, 0, 2] = 0.8 * speed * seconds(fps)
    return feet


@pytest.mark.parametrize("fps", [20.0, 120.0])
def test_one_foot_joint_of_four_that_slides(fps: float) -> None:
    # On the floor every sliding joint counts in full; at half of its height H by 2 − √2.
    assert skating_speed(sliding_feet(fps, 0.0, 1.0), fps) == pytest.approx(0.25)
    assert skating_speed(sliding_feet(fps, 0.04, 1.0), fps) == pytest.approx(0.25 * (2 - 2**0.5))
    assert skating_speed(sliding_feet(fps, 0.08, 1.0), fps) == pytest.approx(0.0)
    assert skating_speed(sliding_feet(fps, -0.5, 1.0), fps) == pytest.approx(0.25)
    assert skating_speed(sliding_feet(fps, 0.54, 1.0), fps, floor=0.5) == pytest.approx(0.25 * (2 - 2**0.5))


def test_skating_agrees_with_loops() -> None:
    rng = np.random.default_rng(2)
    feet = rng.uniform(0, 0.1, size=(30, 2, 3))
    total = 0.0
    for now, after in pairwise(feet):
        speeds = [float(np.hypot(b[0] - a[0], b[2] - a[2])) * 10 for a, b in zip(now, after, strict=True)]
        total += sum(v * (2 - 2 ** min(max(a[1] / h, 0), 1)) for v, a, h in zip(speeds, now, (0.08, 0.04), strict=True))
    assert skating_speed(feet, 10.0, (0.08, 0.04)) == pytest.approx(total / 58, rel=1e-12)


def test_refusals() -> None:
    motion = np.zeros((3, 2, 3))
    broken = motion.copy()
    broken[1, 0, 0] = np.nan
    with pytest.raises(ValueError, match="at least 4 frames, not 3"):
        jerk_error(motion, motion, 20.0)
    for error in ERRORS:
        with pytest.raises(ValueError, match="NaN"):
            error(broken, motion, 20.0)
        with pytest.raises(ValueError, match="fps must be positive"):
            error(np.zeros((4, 1, 3)), np.zeros((4, 1, 3)), 0.0)
    with pytest.raises(ValueError, match="the first is row 1"):
        skating_speed(broken, 20.0, (0.1, 0.1))
    with pytest.raises(ValueError, match="2 foot joints and heights"):
        skating_speed(motion, 20.0)
