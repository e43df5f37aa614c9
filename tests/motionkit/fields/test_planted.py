from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import motionkit as mk
from motionkit.core.kinematics import forward_kinematics
from motionkit.fields.contact.planted import Path as BodyPath
from motionkit.fields.contact.planted import planted
from motionkit.fields.interpolation import interpolate
from motionkit.fields.motion_field import MotionField, to_motion
from tests.helpers.analytic import capture
from tests.helpers.velocities import joint_velocities

FPS = Fraction(60)
FEET = (7, 10, 8, 11)


def slid(motion: mk.Motion, metres_a_second: float) -> mk.Motion:
    """The same body on a moving floor: everything slides along X."""
    times = motion.timegrid.seconds() - motion.timegrid.start_seconds
    step = np.zeros((motion.num_frames, 3), np.float32)
    step[:, 0] = metres_a_second * times
    translation = None if motion.root_translation is None else motion.root_translation + step
    return replace(motion, joint_positions=motion.joint_positions + step[:, None], root_translation=translation)


def field_of(motion: mk.Motion, path: BodyPath = "free") -> MotionField:
    method = "cubic" if motion.local_rotations is None else "slerp"
    return planted(interpolate(motion, method), path)


def bare(motion: mk.Motion) -> mk.Motion:
    return replace(motion, local_rotations=None, root_translation=None)


def steadiest_speed(positions: np.ndarray, still: np.ndarray, fps: Fraction) -> np.ndarray:
    """Horizontal speed of each foot's steadier joint while the true foot is planted."""
    feet = positions[:, FEET][..., ::2].reshape(len(positions), 2, 2, 2)
    speed = np.linalg.norm(np.diff(feet, axis=0), axis=-1).min(axis=-1) * float(fps)
    return speed[still]


def true_rests(motion: mk.Motion) -> np.ndarray:
    """Where one joint of a foot of the capture doesn't move between two frames, nor within 0.1 s."""
    feet = motion.joint_positions[:, FEET].reshape(motion.num_frames, 2, 2, 3)
    rests = (np.linalg.norm(np.diff(feet, axis=0), axis=-1) * float(motion.fps) < 0.01).any(axis=-1)
    margin = int(float(motion.fps) / 10)
    kept = rests.copy()
    for shift in range(1, margin + 1):
        kept[shift:] &= rests[:-shift]
        kept[:-shift] &= rests[shift:]
    return kept


@pytest.mark.parametrize("rotations", [True, False])
def test_feet_that_slide_stand(rotations: bool) -> None:
    motion = capture(FPS, "walk", seconds=6.0)
    still = true_rests(motion)
    given_motion = slid(motion if rotations else bare(motion), 0.2)
    after = to_motion(field_of(given_motion), FPS)
    before = steadiest_speed(given_motion.joint_positions, still, FPS)
    now = steadiest_speed(after.joint_positions, still, FPS)
    assert before.mean() > 0.19
    assert now.mean() < 0.02
    assert np.quantile(now, 0.95) < 0.05
    # The path that feet carry the body along is the capture's own.
    off = after.joint_positions[:, 0] - motion.joint_positions[:, 0]
    assert np.abs(off - off[0])[:, ::2].max() < 0.25


def test_generated_feet_stand_where_captured_ones_may_creep() -> None:
    """4 cm/s over contacts of 0.6 s, where real feet go at up to 5.4."""
    motion = capture(FPS, "walk", seconds=6.0)
    still, creeping = true_rests(motion), bare(slid(motion, 0.04))
    near, free = to_motion(field_of(creeping, "near"), FPS), to_motion(field_of(creeping, "free"), FPS)
    assert steadiest_speed(near.joint_positions, still, FPS).mean() == pytest.approx(0.04, rel=0.1)
    assert steadiest_speed(free.joint_positions, still, FPS).mean() < 0.015


@pytest.mark.parametrize("action", ["walk", "run", "circle", "squat", "wave"])
def test_feet_that_stand_are_left_alone(action: str) -> None:
    motion = capture(FPS, action)
    after = to_motion(field_of(bare(motion), "near"), FPS)
    change = np.linalg.norm(after.joint_positions - motion.joint_positions, axis=-1)
    assert change.max() < 0.01
    assert change.mean() < 0.001


def test_feet_below_the_floor_come_up() -> None:
    motion = bare(capture(FPS, "walk", seconds=12.0))
    sunk = motion.joint_positions.copy()
    floor = np.quantile(sunk[:, FEET, 1].min(axis=1), 0.05)
    sunk[150:162, ..., 1] -= 0.04 * np.sin(np.linspace(0, np.pi, 12))[:, None]
    after = to_motion(field_of(replace(motion, joint_positions=sunk)), FPS).joint_positions
    assert floor - sunk[..., 1].min() > 0.03
    assert floor - after[..., 1].min() < 0.005


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from(["walk", "run", "squat", "circle"]), st.booleans())
def test_it_is_one_function_of_time(seed: int, action: str, rotations: bool) -> None:
    motion = capture(Fraction(30), action, seconds=3.0, seed=seed)
    field = field_of(slid(motion if rotations else bare(motion), 0.15))
    fast, slow = to_motion(field, Fraction(60)), to_motion(field, Fraction(30))
    np.testing.assert_array_equal(fast.joint_positions[::2], slow.joint_positions)
    rng = np.random.default_rng(seed)
    times = rng.permutation(slow.timegrid.seconds())
    order = np.argsort(times)
    np.testing.assert_array_equal(field.query(times).joint_positions[order], slow.joint_positions)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from(["walk", "run", "squat"]))
def test_velocity_is_continuous(seed: int, action: str) -> None:
    motion = bare(capture(Fraction(120), action, seconds=3.0, seed=seed))
    field = field_of(slid(motion, 0.15))
    times = np.linspace(field.start_seconds + 0.05, field.end_seconds - 0.05, 4000)
    below = interpolate(slid(motion, 0.15), "cubic")
    own = joint_velocities(field, times) - joint_velocities(below, times)
    # Where accelerations are bounded, velocity moves little within 0.7 ms.
    assert np.linalg.norm(np.diff(own, axis=0), axis=-1).max() < 0.25


def test_generated_bones_keep_their_length_exactly() -> None:
    """A millimetre of noise on joints is within what bones of captures change by, and these are left alone."""
    motion = bare(capture(Fraction(60), "walk", seconds=3.0, seed=3, noise=0.001))
    drift = {}
    for path in ("near", "free"):
        after = to_motion(field_of(motion, path), FPS).joint_positions.astype(np.float64)
        lengths = np.linalg.norm(after[:, 1:] - after[:, list(mk.SMPL22.parents[1:])], axis=-1)
        drift[path] = np.ptp(lengths, axis=0).max()
    assert drift["free"] < 5e-6 < 1e-3 < drift["near"]


def test_rotations_agree_with_positions() -> None:
    motion = slid(capture(FPS, "walk"), 0.2)
    assert motion.local_rotations is not None
    assert motion.root_translation is not None
    after = to_motion(field_of(motion), FPS)
    assert after.local_rotations is not None
    assert after.root_translation is not None
    again = forward_kinematics(after.local_rotations, after.root_translation, motion.skeleton)
    before = forward_kinematics(motion.local_rotations, motion.root_translation, motion.skeleton)
    missed = np.abs(before - motion.joint_positions).max()
    np.testing.assert_allclose(again, after.joint_positions, atol=missed + 2e-5)
