"""Interpolators that come to rest: the same between frames, then smoothly to a stop, limbs before the path."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from motionkit.core.motion import Motion
from motionkit.core.skeleton import Skeleton
from motionkit.core.timegrid import TimeGrid
from motionkit.fields.completion import complete
from motionkit.fields.interpolation import INTERPOLATORS, Settling
from motionkit.fields.joints import Joints
from motionkit.fields.motion_field import MotionEncoder, MotionField, Observation, Poses
from tests.helpers.turning_body import random_motion
from tests.helpers.velocities import joint_velocities

NAMES = ("slerp", "squad", "rotation-cubic")


@pytest.mark.parametrize("name", NAMES)
def test_between_frames_it_is_the_interpolator(name: str) -> None:
    motion = random_motion(1)
    encoder = Settling(INTERPOLATORS[name])
    assert isinstance(encoder, MotionEncoder) and encoder.name == name
    plain = INTERPOLATORS[name].encode(Observation.of(motion))
    field = encoder.encode(Observation.of(motion), before_seconds=1.0, after_seconds=2.0)
    assert isinstance(field, MotionField)
    times = np.random.default_rng(0).uniform(plain.start_seconds, plain.end_seconds, 50)
    np.testing.assert_array_equal(field.query(times).joint_positions, plain.query(times).joint_positions)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("rotations", [True, False])
def test_it_leaves_the_ends_with_their_velocity_and_stops(name: str, rotations: bool) -> None:
    motion = random_motion(2)
    if not rotations:
        motion = replace(motion, local_rotations=None, root_translation=None)
    field = Settling(INTERPOLATORS[name]).encode(Observation.of(motion), before_seconds=9.0, after_seconds=9.0)
    first, last = float(motion.timegrid.seconds()[0]), float(motion.timegrid.seconds()[-1])
    for end, inwards in ((first, 1.0), (last, -1.0)):
        inside = joint_velocities(field, np.array([end + 2e-4 * inwards]), step_seconds=1e-4)
        outside = joint_velocities(field, np.array([end - 2e-4 * inwards]), step_seconds=1e-4)
        assert np.abs(inside - outside).max() < 0.1 * np.abs(inside).max()
    far = field.query(np.array([first - 9.0, first - 8.0, last + 8.0, last + 9.0]))
    assert (far.local_rotations is not None) == rotations
    np.testing.assert_allclose(far.joint_positions[0], far.joint_positions[1], atol=1e-3)
    np.testing.assert_allclose(far.joint_positions[2], far.joint_positions[3], atol=1e-3)


def test_it_travels_on_by_what_it_would_in_so_many_seconds() -> None:
    motion = random_motion(3)
    steady = np.arange(20, dtype=np.float32)[:, None] * np.array([0.02, 0.0, 0.01], np.float32)
    shift = (steady - motion.joint_positions[:, 0])[:, None]
    motion = replace(motion, joint_positions=motion.joint_positions + shift, root_translation=steady)
    slow = Settling(INTERPOLATORS["slerp"], joints_seconds=0.1, root_seconds=0.5)
    made = complete(motion, slow, after_seconds=8.0)
    gone = made.joint_positions[-1, 0] - motion.joint_positions[-1, 0]
    np.testing.assert_allclose(gone, 0.5 * 30 * np.array([0.02, 0.0, 0.01]), rtol=1e-4)
    assert made.root_translation is not None
    np.testing.assert_allclose(made.root_translation, made.joint_positions[:, 0], atol=1e-6)
    before, after = (Joints.of(Poses.of(each), motion.skeleton).bones for each in (motion, made))
    np.testing.assert_allclose(after[-1], before[-1], atol=1e-5)


@pytest.mark.parametrize("settling", [True, False])
def test_hips_that_travel_in_a_reference_on_the_floor_do_not_stop_at_the_end(settling: bool) -> None:
    names = ("reference", "hips", "head")
    skeleton = Skeleton("placed", names, (-1, 0, 1), np.array([[0, 0, 0], [0, 0.9, 0], [0, 0.6, 0]], np.float32))
    seconds = np.arange(30) / 30
    positions = np.zeros((30, 3, 3), np.float32)
    positions[:, 1:, 1] = 0.9, 1.5
    positions[:, 1:, 2] = 1.5 * seconds[:, None]
    still = np.tile(np.array([1.0, 0, 0, 0], np.float32), (30, 3, 1))
    motion = Motion(positions, skeleton, TimeGrid(Fraction(30), 30), still, positions[:, 0])
    interpolator = INTERPOLATORS["rotation-cubic"]
    made = complete(motion, Settling(interpolator) if settling else interpolator, after_seconds=0.1)
    step = np.diff(made.joint_positions[28:, :, 2], axis=0)
    np.testing.assert_allclose(step[:, 0], 0.0, atol=1e-6)
    assert (step[:, 1:] > 0.04).all() and (step[:, 1:] < 0.0501).all()
    np.testing.assert_allclose(step[:, 1], step[:, 2], atol=1e-6)
