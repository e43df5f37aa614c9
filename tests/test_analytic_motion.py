"""The analytic motion of the tests: its answers are true of the poses that it gives."""

from fractions import Fraction

import numpy as np
import pytest

from motionkit.core.kinematics import forward_kinematics
from motionkit.fields.motion_field import MotionField, to_motion
from tests.helpers.analytic import ACTIONS, analytic_motion


@pytest.mark.parametrize("seed", [0, 5])
@pytest.mark.parametrize("action", ACTIONS)
def test_known_answers(action: str, seed: int) -> None:
    field = analytic_motion(action, 3.0, seed)
    assert isinstance(field, MotionField)
    motion = to_motion(field, Fraction(240))
    times, positions = motion.timegrid.seconds(), motion.joint_positions
    assert np.array_equal(to_motion(field, Fraction(60)).joint_positions, positions[::4])
    turned = forward_kinematics(motion.local_rotations, motion.root_translation, motion.skeleton)
    assert np.allclose(turned, positions, atol=2e-6)
    velocity = (field.root(times + 1e-5) - field.root(times - 1e-5)) / 2e-5
    assert np.allclose(velocity, field.root_velocity(times), atol=1e-6)
    left, _, forward = np.diff(positions[:, [2, 1]], axis=1)[:, 0].T
    assert np.allclose(np.unwrap(np.arctan2(-forward, left)), field.heading(times), atol=1e-4)
    ankles, _, stands = field.feet(times)
    assert np.allclose(positions[:, [7, 8]][stands], ankles[stands], atol=2e-6)
    still = stands[1:] & stands[:-1]
    for joints in ([7, 8], [10, 11]):
        assert np.abs(np.diff(positions[:, joints], axis=0))[still].max() == 0.0
    assert stands.any(axis=0).all() and positions[..., 1].min() == 0.0
