"""Smoothing before the native evaluator's input: a known filter, the same in hertz at every framerate."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eval.native_evaluator.network import CUTOFF_HZ, prepare, smooth
from eval.sets.corruptions import shift_between_frames

RNG = np.random.default_rng(0)


def wave(hertz: float, fps: float, seconds: float = 2.0) -> np.ndarray:
    """One clip in which every coordinate swings with its own phase."""
    time = np.arange(int(seconds * fps))[:, None, None] / fps
    return np.sin(2 * np.pi * hertz * time + np.random.default_rng(1).uniform(0, 6, (22, 3)))[None]


@given(num_poses=st.integers(4, 70), fps=st.sampled_from([20.0, 59.94, 120.0, 480.0]))
def test_smoothing_solves_the_penalised_least_squares(num_poses: int, fps: float) -> None:
    clips = RNG.normal(size=(2, num_poses, 22, 3))
    difference = np.diff(np.eye(num_poses), n=2, axis=0)
    weight = (fps / (2 * np.pi * CUTOFF_HZ)) ** 4
    expected = np.linalg.solve(np.eye(num_poses) + weight * difference.T @ difference, clips.reshape(2, num_poses, 66))
    np.testing.assert_allclose(smooth(clips, fps).reshape(expected.shape), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(("hertz", "fps"), [(3.0, 120.0), (25.0, 120.0), (55.0, 120.0), (25.0, 960.0), (10.0, 40.0)])
def test_a_wave_keeps_its_phase_and_gets_the_gain(hertz: float, fps: float) -> None:
    clip = wave(hertz, fps)
    gain = 1 / (1 + (fps / (2 * np.pi * CUTOFF_HZ) * 2 * np.sin(np.pi * hertz / fps)) ** 4)
    middle = slice(clip.shape[1] // 4, -clip.shape[1] // 4)
    np.testing.assert_allclose(smooth(clip, fps)[:, middle], gain * clip[:, middle], atol=1e-3)
    if fps > 20 * hertz:
        assert gain == pytest.approx(1 / (1 + (hertz / CUTOFF_HZ) ** 4), rel=0.01)


@given(fps=st.sampled_from([20.0, 40.0, 120.0]), num_poses=st.integers(8, 64))
def test_constant_velocity_passes_unchanged_up_to_the_ends(fps: float, num_poses: int) -> None:
    start, velocity = RNG.normal(size=(2, 3, 1, 22, 3))
    clips = start + velocity * np.arange(num_poses)[:, None, None] / fps
    np.testing.assert_allclose(smooth(clips, fps), clips, atol=1e-9)


def test_motion_looks_the_same_at_every_framerate() -> None:
    slow, fast = wave(4.0, 60.0), wave(4.0, 240.0)[:, ::4]
    middle = slice(20, -20)
    assert np.abs(smooth(slow, 60.0)[:, middle] - smooth(wave(4.0, 240.0), 240.0)[:, ::4][:, middle]).max() < 2e-3
    np.testing.assert_allclose(slow, fast, atol=1e-12)


def test_half_a_frame_of_capture_noise_is_mostly_the_same() -> None:
    noisy = RNG.normal(0, 1e-3, (8, 256, 22, 3))
    shifted = shift_between_frames(noisy)

    def lost(before: np.ndarray, after: np.ndarray) -> float:
        """Share of the accelerations' power that the interpolation takes away."""
        powers = [np.var(np.diff(clips, n=2, axis=1)[:, 64:-64]) for clips in (before, after)]
        return float(1 - powers[1] / powers[0])

    assert lost(noisy, shifted) > 0.03
    assert lost(smooth(noisy, 120.0), smooth(shifted, 120.0)) < 0.5 * lost(noisy, shifted)


def test_prepared_clips_begin_above_the_origin_in_single_precision() -> None:
    clips = RNG.normal(size=(3, 16, 22, 3)).cumsum(axis=1)
    prepared = prepare(clips, 120.0)
    assert prepared.dtype == np.float32 and prepared.shape == clips.shape
    far = prepare(clips + np.array([1000.0, 0.0, -2000.0]), 120.0)
    np.testing.assert_allclose(far, prepared, atol=1e-5)
    np.testing.assert_allclose(prepared[..., 1], smooth(clips, 120.0)[..., 1], atol=1e-5)
