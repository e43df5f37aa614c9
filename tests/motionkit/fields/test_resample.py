from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import motionkit as mk
from motionkit.core import kinematics
from motionkit.fields.resample import resample, resample_positions
from tests.helpers.turning_body import random_motion

NTSC = Fraction(30000, 1001)


def sinusoid(hertz: float, fps: Fraction, seconds: float, phase: float = 0.3) -> np.ndarray:
    frames = np.arange(int(seconds * fps) + 1)
    wave = np.sin(2 * np.pi * hertz * frames * fps.denominator / fps.numerator + phase)
    return np.broadcast_to(wave[:, None, None], (len(frames), 1, 3)).copy()


RATES = [
    (Fraction(120), Fraction(20)),
    (Fraction(120), Fraction(50)),
    (Fraction(60), NTSC),
    (Fraction(100), Fraction(40)),
]


@pytest.mark.parametrize(("fps_from", "fps_to"), RATES)
@pytest.mark.parametrize("part", [0.05, 0.3, 0.6, 0.8])
def test_the_passband_is_flat_and_without_delay(fps_from: Fraction, fps_to: Fraction, part: float) -> None:
    hertz = part * float(fps_to) / 2
    result = resample_positions(sinusoid(hertz, fps_from, 10), fps_from, fps_to)
    expected = sinusoid(hertz, fps_to, 10)[: len(result)]
    middle = slice(len(result) // 4, -len(result) // 4)
    assert np.abs(result - expected)[middle].max() < 3e-4


@pytest.mark.parametrize(("fps_from", "fps_to"), RATES)
@pytest.mark.parametrize("part", [1.001, 1.2, 1.9])
def test_nothing_above_the_new_nyquist_frequency_folds_back(fps_from: Fraction, fps_to: Fraction, part: float) -> None:
    hertz = part * float(fps_to) / 2
    result = resample_positions(sinusoid(hertz, fps_from, 10), fps_from, fps_to)
    assert np.abs(result[len(result) // 4 : -len(result) // 4]).max() < 3e-4


@settings(max_examples=30)
@given(st.integers(1, 60), st.fractions(5, 120, max_denominator=1001), st.fractions(5, 120, max_denominator=1001))
def test_constants_and_ends_survive_any_pair_of_rates(frames: int, fps_from: Fraction, fps_to: Fraction) -> None:
    still = np.full((frames, 2, 3), 3.5)
    result = resample_positions(still, fps_from, fps_to)
    assert np.allclose(result, 3.5, atol=1e-12)
    grid = mk.TimeGrid(fps_to, len(result))
    assert grid.span_seconds <= (frames - 1) / fps_from + 1e-6 < float(len(result) / fps_to) + 2e-6
    walk = np.cumsum(np.ones((frames, 1, 3)), axis=0)
    assert np.allclose(resample_positions(walk, fps_from, fps_to)[0], 1.0, atol=1e-9)


def test_downsampling_filters_rotations_and_positions_together() -> None:
    motion = random_motion(12, num_frames=240, fps=Fraction(120))
    shaken = motion.local_rotations
    assert shaken is not None
    slow = resample(motion, Fraction(60))
    assert slow.fps == 60 and slow.num_frames == 120
    assert slow.local_rotations is not None and slow.root_translation is not None
    assert np.allclose(np.linalg.norm(slow.local_rotations, axis=-1), 1.0, atol=1e-6)
    again = kinematics.forward_kinematics(slow.local_rotations, slow.root_translation, mk.SMPL22)
    assert np.allclose(again, slow.joint_positions, atol=2e-4)


def test_an_unknown_method_is_refused(unchecked_annotations: None) -> None:
    with pytest.raises(ValueError, match="'cubicc'"):
        resample(random_motion(13), 60, "cubicc")  # type: ignore[arg-type]


def test_resample_goes_both_ways() -> None:
    motion = random_motion(13)
    assert resample(motion, Fraction(30)) is motion
    assert resample(motion, Fraction(15)).num_frames == 10
    assert resample(motion, Fraction(60)).num_frames == 39
