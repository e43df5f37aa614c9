from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import motionkit as mk
from motionkit.core.kinematics import forward_kinematics
from motionkit.fields.detail import NUM_BANDS, Detail, band_power, detailed, displacements, fit_detail, steps, with_ends
from motionkit.fields.interpolation import interpolate
from motionkit.fields.motion_field import to_motion
from motionkit.fields.resample import resample_positions
from tests.helpers.analytic import capture

NATIVE = Fraction(120)
FOOT = 10
STILL_METRES, MOVING_METRES = 0.0005, 0.004


def shaken(motion: mk.Motion, seed: int) -> mk.Motion:
    """A capture whose joints tremble by 0.5 mm, and eight times as much while they move at 0.5 m/s or more."""
    speed = np.linalg.norm(np.gradient(motion.joint_positions, 1 / float(motion.fps), axis=0), axis=-1)
    strength = np.where(speed > 0.5, MOVING_METRES, STILL_METRES)[..., None]
    noise = strength * np.random.default_rng(seed).standard_normal(motion.joint_positions.shape)
    return replace(motion, joint_positions=(motion.joint_positions + noise).astype(np.float32), local_rotations=None)


@pytest.fixture(scope="module")
def learnt() -> Detail:
    takes = [shaken(capture(NATIVE, action, 10.0, seed=n), n) for n, action in enumerate(("walk", "run", "walk"))]
    return fit_detail([take.joint_positions for take in takes])


@pytest.fixture(scope="module")
def smooth() -> mk.Motion:
    motion = capture(NATIVE, "walk", 8.0, seed=7)
    return replace(motion, local_rotations=None, root_translation=None)


def on_grid(motion: mk.Motion, detail: Detail) -> np.ndarray:
    return displacements(interpolate(motion, "cubic"), detail, (3, 0))


def test_detail_is_as_strong_as_captures_are_in_such_moments(learnt: Detail, smooth: mk.Motion) -> None:
    added = on_grid(smooth, learnt).reshape(-1, 22, 3)
    speed = np.linalg.norm(np.gradient(smooth.joint_positions[:, FOOT], 1 / 120, axis=0), axis=-1)
    fast, still = (np.sqrt(np.square(added[mask, FOOT]).sum(-1).mean()) for mask in (speed > 0.8, speed < 0.1))
    # What lies above 10 Hz of white noise at 120 fps is five sixths of its power.
    assert fast == pytest.approx(MOVING_METRES * np.sqrt(3 * 5 / 6), rel=0.3)
    assert still < fast / 3


@settings(max_examples=8, deadline=None)
@given(slow=st.sampled_from([24, 30, 40]), faster=st.sampled_from([2, 3]))
def test_a_framerate_is_a_faster_one_low_passed(learnt: Detail, smooth: mk.Motion, slow: int, faster: int) -> None:
    added, rates = on_grid(smooth, learnt), (Fraction(slow), Fraction(slow * faster))
    few, many = (steps(added, np.arange(int(7 * fps)) / float(fps), fps) for fps in rates)
    filtered = resample_positions(many, rates[1], rates[0])
    inner = slice(slow, len(few) - slow)
    assert few.std() > 1e-4
    assert np.abs(filtered - few)[inner].max() < 0.006 * np.abs(few).max()


@pytest.mark.parametrize("fps", [30, 60, 100])
def test_nothing_lies_above_half_the_framerate(learnt: Detail, smooth: mk.Motion, fps: int) -> None:
    times = np.arange(1600) / 240.0
    added = steps(on_grid(smooth, learnt), times, Fraction(fps))[:, FOOT, 1]
    power = np.square(np.abs(np.fft.rfft(added * np.hanning(len(added)))))
    hz = np.fft.rfftfreq(len(added), 1 / 240)
    assert power[hz > fps / 2].sum() < 1e-5 * power.sum()
    assert power[(hz > 0.7 * fps / 2) & (hz < 0.8 * fps / 2)].sum() > 1e-3 * power.sum()


@pytest.mark.parametrize("rotations", [True, False])
def test_bones_keep_their_length(learnt: Detail, rotations: bool) -> None:
    motion = capture(NATIVE, "walk", 3.0)
    if not rotations:
        motion = replace(motion, local_rotations=None, root_translation=None)
    field = detailed(interpolate(motion, "slerp" if rotations else "cubic"), learnt, seed=3)
    before, after = (to_motion(each, Fraction(90)) for each in (field.field, field))
    parents = list(mk.SMPL22.parents[1:])
    lengths = [
        np.linalg.norm(each.joint_positions[:, 1:] - each.joint_positions[:, parents], axis=-1)
        for each in (before, after)
    ]
    np.testing.assert_allclose(*lengths, atol=2e-6)
    moved = np.linalg.norm(after.joint_positions - before.joint_positions, axis=-1)
    assert 5e-4 < moved.mean() < 0.01
    if rotations:
        assert after.local_rotations is not None and after.root_translation is not None
        rotations_in_full, root = (each.astype(np.float64) for each in (after.local_rotations, after.root_translation))
        shown = forward_kinematics(rotations_in_full, root, motion.skeleton)
        np.testing.assert_allclose(shown, after.joint_positions, atol=2e-5)


def test_what_a_capture_has_already_is_not_added_again(learnt: Detail, smooth: mk.Motion) -> None:
    real = shaken(smooth, 5)
    added = [on_grid(each, learnt) for each in (smooth, real)]
    assert np.square(added[1]).mean() < 0.35 * np.square(added[0]).mean()
    power = band_power(with_ends(real.joint_positions))
    assert power.shape == (real.num_frames, NUM_BANDS, 22)
