"""Captures brought to a higher framerate: the rate of the capture is found, and no other take is suspected."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from motionkit.core.motion import Motion
from motionkit.core.timegrid import TimeGrid
from motionkit.features.quality import measure
from motionkit.fields.interpolation import interpolate
from motionkit.fields.motion_field import to_motion
from tests.helpers.analytic import capture

# Noise as marker capture has it, so that nothing is smoother than a capture.
NOISE = 0.0005


def hold(motion: Motion, fps: Fraction) -> Motion:
    """Every frame repeated until the next one is due."""
    num_frames = int(motion.num_frames * fps / motion.fps)
    frames = np.arange(num_frames) * motion.fps.numerator * fps.denominator
    frames //= motion.fps.denominator * fps.numerator
    return replace(
        motion,
        joint_positions=motion.joint_positions[frames],
        timegrid=TimeGrid(fps, num_frames),
        local_rotations=None,
        root_translation=None,
    )


def upsample(motion: Motion, method: str, fps: Fraction) -> Motion:
    if method == "hold":
        return hold(motion, fps)
    return to_motion(interpolate(motion, method), fps)


@pytest.mark.parametrize("method", ["hold", "linear", "slerp", "cubic"])
@pytest.mark.parametrize(
    ("captured", "stated"), [(60, 120), (30, 60), (30, 90), (30, 120), (20, 120), (24, 60), (30, 100)]
)
def test_the_framerate_of_the_capture_is_reported(method, captured, stated):
    # SLERP goes through the rotations, which have to be as noisy as the positions: those of the plain performance.
    noise = 0.0 if method == "slerp" else NOISE
    upsampled = upsample(capture(Fraction(captured), "walk", 6.0, noise), method, Fraction(stated))
    quality = measure(upsampled)
    assert quality.effective_fps == pytest.approx(captured)
    assert "upsampled" in quality.flags


@pytest.mark.parametrize("fps", [30, 60, 100, 120, 240])
@pytest.mark.parametrize("action", ["walk", "run", "squat", "wave"])
@pytest.mark.parametrize("noise", [0.0, NOISE, 0.003])
def test_a_capture_is_not_suspected(fps, action, noise):
    motion = capture(Fraction(fps), action, 5.0, noise)
    assert measure(motion).effective_fps == fps


def test_pulldown_from_film_is_held_frames():
    quality = measure(upsample(capture(Fraction(24), "walk", 6.0, NOISE), "hold", Fraction(30)))
    assert quality.effective_fps == 24.0
    assert quality.held_share == pytest.approx(0.2, abs=0.01)


@pytest.mark.parametrize(
    ("captured", "stated"), [(10, 20), (Fraction(25, 4), Fraction(25, 2)), (5, 10), (40, 60), (7, 30)]
)
def test_held_frames_are_counted_at_any_rate(captured, stated):
    quality = measure(upsample(capture(Fraction(captured), "walk", 20.0, NOISE), "hold", Fraction(stated)))
    assert quality.effective_fps == pytest.approx(float(captured), rel=0.02)


@pytest.mark.parametrize("fps", [1, 5, Fraction(25, 2), 20, 1000, 10_000])
def test_any_framerate_is_measured(fps):
    motion = capture(Fraction(60), "walk", 3.0, NOISE)
    odd = replace(motion, timegrid=TimeGrid(Fraction(fps), motion.num_frames))
    assert measure(odd).effective_fps is not None
