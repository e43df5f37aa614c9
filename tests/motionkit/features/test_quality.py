"""Figures of motions whose faults were put in by hand, at several framerates."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

import motionkit as mk
from motionkit.features.quality import measure
from motionkit.fields.interpolation import interpolate
from motionkit.fields.motion_field import to_motion
from tests.helpers.analytic import capture

RATES = (Fraction(30), Fraction(60000, 1001), Fraction(120), Fraction(250))


def altered(motion: mk.Motion, positions: np.ndarray) -> mk.Motion:
    return replace(
        motion,
        joint_positions=positions.astype(np.float32),
        timegrid=mk.TimeGrid(motion.fps, len(positions)),
        local_rotations=None,
        root_translation=None,
    )


@pytest.mark.parametrize("fps", RATES)
@pytest.mark.parametrize("action", ["walk", "run", "squat", "wave"])
def test_clean_motion_raises_no_flag(action, fps):
    assert measure(capture(fps, action)).flags == ()


def test_figures_mean_the_same_at_every_framerate():
    """The jerk and the skate of one analytic motion, sampled at 30 … 250 fps."""
    figures = [measure(capture(fps, "run")) for fps in RATES]
    jitter = [figure.jitter_metres_per_second_cubed for figure in figures]
    assert np.ptp(jitter) < 0.25 * jitter[0]
    assert np.ptp([figure.foot_skate_metres_per_second for figure in figures]) < 0.01


def test_jitter_is_what_noise_of_its_size_gives():
    """White noise σ in frames at f fps has σ √(30 / f) in bins, and third differences √20 times that."""
    for fps in (60, 120, 240):
        still = np.broadcast_to(capture(Fraction(fps)).joint_positions[:1], (30 * fps, 22, 3))
        noise = 0.003 * np.random.default_rng(2).standard_normal(still.shape)
        jerk = measure(altered(capture(Fraction(fps)), still + noise)).jitter_metres_per_second_cubed
        # The lower quartile of the length of a standard normal 3-vector is 1.101.
        assert jerk == pytest.approx(1.101 * 0.003 * np.sqrt(20 * 30 / fps) * 30**3, rel=0.03)


@pytest.mark.parametrize("fps", RATES)
@pytest.mark.parametrize("returns", [True, False])
def test_a_teleport_is_counted_and_placed(fps, returns):
    """A joint that is half a metre off for a frame makes two long steps, one that stays there makes one."""
    motion = capture(fps)
    frame = int(2 * fps)
    positions = motion.joint_positions.copy()
    positions[frame : frame + 1 if returns else None, 20, 0] += 0.5
    quality = measure(altered(motion, positions))
    assert quality.num_teleports == (2 if returns else 1)
    assert quality.first_teleport_seconds == pytest.approx(frame / float(fps))
    assert "teleport" in quality.flags


@pytest.mark.parametrize("fps", RATES)
def test_the_longest_frozen_stretch_is_found(fps):
    motion = capture(fps)
    start, length = int(3 * fps), int(fps / 2)
    positions = motion.joint_positions.copy()
    positions[start : start + length] = positions[start]
    positions[10:12] = positions[10]
    quality = measure(altered(motion, positions))
    assert quality.frozen_seconds == pytest.approx((length - 1) / float(fps))
    assert quality.frozen_start_seconds == pytest.approx(start / float(fps))
    assert quality.held_share == pytest.approx(length / (len(positions) - 1))
    assert "frozen" in quality.flags


@pytest.mark.parametrize("fps", RATES)
def test_sliding_feet_slide_at_the_speed_of_the_body(fps):
    """A body that stands and is carried along at 0.5 m/s."""
    motion = capture(fps, "wave")
    seconds = motion.timegrid.seconds()
    positions = np.broadcast_to(motion.joint_positions[:1], motion.joint_positions.shape) + 0.0
    positions[..., 2] += 0.5 * seconds[:, None]
    quality = measure(altered(motion, positions))
    assert quality.foot_skate_metres_per_second == pytest.approx(0.5, abs=0.01)
    assert quality.foot_skate_share == 1.0
    assert quality.flags == ("foot_skate",)


def test_a_bone_that_grows_drifts():
    motion = capture(Fraction(60))
    positions = motion.joint_positions.copy()
    growth = np.linspace(0.0, 0.2, len(positions), dtype=np.float32)[:, None]
    positions[:, 20] += growth * (positions[:, 20] - positions[:, 18])
    quality = measure(altered(motion, positions))
    assert quality.bone_length_drift == pytest.approx(0.2 / 1.1, abs=0.01)
    assert quality.flags == ("bone_length",)
    assert measure(motion).bone_length_drift < 1e-4


@pytest.mark.parametrize("scale", [0.0, 1e-30, 1e12, 3e38])
@pytest.mark.parametrize("num_frames", [1, 2, 61])
def test_figures_are_finite_whatever_the_numbers(scale, num_frames):
    """They become columns and JSON, and no warning may come out of an ingest."""
    values = scale * np.random.default_rng(0).uniform(-1, 1, (num_frames, 22, 3))
    for fps in (1, 30, 10_000):
        motion = mk.Motion(values.astype(np.float32), mk.SMPL22, mk.TimeGrid(Fraction(fps), num_frames))
        figures = [figure for figure in vars(measure(motion)).values() if isinstance(figure, float)]
        assert np.isfinite(figures).all()


# Noise as marker capture has it, so that nothing is smoother than a capture.
NOISE = 0.0005


@pytest.mark.parametrize("method", ["hold", "linear", "slerp", "cubic"])
@pytest.mark.parametrize(("captured", "stated"), [(60, 120), (30, 90), (20, 120), (24, 60), (30, 100)])
def test_the_framerate_of_the_capture_is_reported(method, captured, stated):
    # SLERP goes through the rotations, which have to be as noisy as the positions: those of the plain performance.
    noise = 0.0 if method == "slerp" else NOISE
    upsampled = to_motion(interpolate(capture(Fraction(captured), "walk", 6.0, noise), method), Fraction(stated))
    quality = measure(upsampled)
    assert quality.effective_fps == pytest.approx(captured)
    assert "upsampled" in quality.flags


@pytest.mark.parametrize("fps", [30, 60, 100, 120, 240])
@pytest.mark.parametrize("action", ["walk", "run", "squat", "wave"])
@pytest.mark.parametrize("noise", [0.0, NOISE, 0.003])
def test_a_capture_is_not_suspected(fps, action, noise):
    motion = capture(Fraction(fps), action, 5.0, noise)
    assert measure(motion).effective_fps == fps


@pytest.mark.parametrize(
    ("captured", "stated"), [(10, 20), (Fraction(25, 4), Fraction(25, 2)), (5, 10), (40, 60), (7, 30)]
)
def test_held_frames_are_counted_at_any_rate(captured, stated):
    held = interpolate(capture(Fraction(captured), "walk", 20.0, NOISE), "hold")
    quality = measure(to_motion(held, Fraction(stated)))
    assert quality.effective_fps == pytest.approx(float(captured), rel=0.02)
