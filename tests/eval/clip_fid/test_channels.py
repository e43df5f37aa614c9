"""Numbers of every pose: known answers of filters, bands and floors; what does not change them."""

from fractions import Fraction

import numpy as np
import pytest

from eval.clip_fid.channels import SLOW_BANDS, channels, noise_power
from motionkit.core.skeleton import SMPL22

FPS = Fraction(120)
SECONDS = np.arange(480) / 120.0


def still(num_frames: int = 480) -> np.ndarray:
    """The rest pose of the 22 joints, standing still."""
    rest = np.zeros((22, 3))
    for joint, parent in enumerate(SMPL22.parents[1:], start=1):
        rest[joint] = rest[parent] + SMPL22.offsets[joint]
    return np.tile(rest, (num_frames, 1, 1))


@pytest.mark.parametrize("hertz", [1.25, 3.75, 6.5])
@pytest.mark.parametrize("fps", [Fraction(20), FPS])
def test_a_sine_has_its_power_in_its_band(hertz: float, fps: Fraction) -> None:
    rate = float(fps)
    motion = still()
    motion[:, :, 0] += 0.01 * np.sin(2 * np.pi * hertz * np.arange(480) / rate)[:, None]
    power = channels(motion, fps).power[60:-60].mean(axis=0)
    inside = [low <= hertz < high for low, high in SLOW_BANDS].index(True)
    # A second difference has (2 fps sin(pi f / fps))^2 of the amplitude.
    expected = (0.01 * (2 * rate * np.sin(np.pi * hertz / rate)) ** 2) ** 2 / 2
    # Neighbouring bands overlap: in the middle of one its gain is 0.9 or more.
    assert power[inside] == pytest.approx(np.full(5, expected), rel=0.25)
    assert np.delete(power, inside, axis=0).max() < 0.05 * expected


def test_noise_has_the_power_of_its_floor() -> None:
    rng = np.random.default_rng(0)
    motion = still(12000) + 0.002 * rng.standard_normal((12000, 22, 3))
    found = channels(motion, FPS).power.mean(axis=(0, 2))
    # Power is that of three coordinates, without what bands lose where they overlap.
    ratio = found / (3 * noise_power(SLOW_BANDS, 0.002))
    assert (ratio > 0.6).all() and (ratio < 1.1).all()


def test_height_and_the_direction_of_time_are_seen() -> None:
    motion = still()
    motion[:, :, 2] += SECONDS[:, None]  # a metre a second forwards
    walk, low, back = (channels(each, FPS) for each in (motion, motion - [0, 0.3, 0], motion[::-1]))
    np.testing.assert_allclose(walk.height - low.height, 0.3, atol=1e-6)
    np.testing.assert_allclose(walk.direction[:, 0], 1.0, atol=1e-6)
    np.testing.assert_allclose(back.direction[:, 0], -1.0, atol=1e-6)


def test_turning_and_moving_the_body_changes_nothing_but_directions() -> None:
    rng = np.random.default_rng(1)
    motion = still() + 0.05 * np.sin(2 * np.pi * rng.uniform(0.5, 9, (22, 3)) * SECONDS[:, None, None])
    sine, cosine = np.sin(0.7), np.cos(0.7)
    turned = motion @ np.array([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]]) + np.array(
        [3.0, 0.0, -2.0]
    )
    first, second = channels(motion, FPS), channels(turned, FPS)
    for name in ("pose", "power", "log_speed", "log_foot_speed", "height", "direction"):
        np.testing.assert_allclose(getattr(second, name), getattr(first, name), rtol=1e-4, atol=1e-6, err_msg=name)


@pytest.mark.parametrize("num_frames", [1, 2, 3, 17])
def test_short_motions_have_finite_channels(num_frames: int) -> None:
    found = channels(still(num_frames), FPS)
    assert all(np.isfinite(values).all() for values in vars(found).values())
    assert len(found.pose) == num_frames
