"""Numbers of every pose: known answers of filters, bands and floors; what does not change them."""

from fractions import Fraction

import numpy as np
import pytest

from eval.clip_fid.channels import Bands, channels, noise_power, smoothed
from motionkit.core.skeleton import SMPL22

FPS = Fraction(120)
SECONDS = np.arange(480) / 120.0


def still(num_frames: int = 480) -> np.ndarray:
    """The rest pose of the 22 joints, standing still."""
    rest = np.zeros((22, 3))
    for joint, parent in enumerate(SMPL22.parents[1:], start=1):
        rest[joint] = rest[parent] + SMPL22.offsets[joint]
    return np.tile(rest, (num_frames, 1, 1))


def test_bands_are_those_that_a_framerate_can_hold() -> None:
    assert Bands.at(Fraction(120)).high == ((12.0, 18.0), (18.0, 27.0), (27.0, 40.0), (40.0, 60.0))
    assert Bands.at(Fraction(40)).high == ((12.0, 20.0),)
    assert Bands.at(Fraction(20)).high == ()
    assert Bands.at(Fraction(20)).middle == ((8.0, 10.0),)
    assert Bands.at(Fraction(25, 2)).low[-1][1] == 6.25


@pytest.mark.parametrize("hertz", [1.25, 3.75, 10.0, 15.0, 22.0, 33.0, 50.0])
def test_a_sine_has_its_power_in_its_band(hertz: float) -> None:
    motion = still()
    motion[:, :, 0] += 0.01 * np.sin(2 * np.pi * hertz * SECONDS)[:, None]
    power = channels(motion, FPS).power[120:-120].mean(axis=0)
    bands = Bands.at(FPS).all
    inside = [low <= hertz < high for low, high in bands].index(True)
    # A second difference has (2 fps sin(pi f / fps))^2 of the amplitude.
    expected = (0.01 * (240 * np.sin(np.pi * hertz / 120)) ** 2) ** 2 / 2
    # Neighbouring bands overlap: in the middle of one its gain is 0.9 or more.
    assert power[inside] == pytest.approx(np.full(5, expected), rel=0.25)
    assert np.delete(power, inside, axis=0).max() < 0.05 * expected


def test_noise_has_the_power_of_its_floor() -> None:
    rng = np.random.default_rng(0)
    motion = still(12000) + 0.002 * rng.standard_normal((12000, 22, 3))
    found = channels(motion, FPS).power.mean(axis=(0, 2))
    bands = Bands.at(FPS).all
    # Power is that of three coordinates, without what bands lose where they overlap. Towards the Nyquist frequency a
    # second difference falls behind (2 pi f)^2, of which the floor is.
    ratio = found / (3 * noise_power(bands, 0.002))
    assert (ratio[:4] > 0.6).all()
    assert (ratio < 1.1).all()
    assert (np.diff(ratio[3:]) < 0).all()


def test_turning_and_moving_the_body_changes_nothing_but_directions() -> None:
    rng = np.random.default_rng(1)
    motion = still() + 0.05 * np.sin(2 * np.pi * rng.uniform(0.5, 9, (22, 3)) * SECONDS[:, None, None])
    sine, cosine = np.sin(0.7), np.cos(0.7)
    turned = motion @ np.array([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]]) + np.array(
        [3.0, 0.0, -2.0]
    )
    first, second = channels(motion, FPS), channels(turned, FPS)
    for name in ("pose", "power", "log_speed", "log_foot_speed", "steady", "sudden", "timing"):
        np.testing.assert_allclose(getattr(second, name), getattr(first, name), atol=1e-6, err_msg=name)


@pytest.mark.parametrize("num_frames", [1, 2, 3, 17])
def test_short_motions_have_finite_channels(num_frames: int) -> None:
    found = channels(still(num_frames), FPS)
    assert all(np.isfinite(values).all() for values in vars(found).values())
    assert len(found.pose) == num_frames


def test_other_joints_are_refused() -> None:
    with pytest.raises(ValueError, match="21 joints"):
        channels(still()[:, :21], FPS)


def test_a_hann_window_keeps_constants_and_its_width_is_in_seconds() -> None:
    np.testing.assert_allclose(smoothed(np.full((50, 2), 3.0), 0.1, 120.0), 3.0)
    impulse = np.zeros((481, 1))
    impulse[240] = 1.0
    assert np.count_nonzero(smoothed(impulse, 0.1, 120.0) > 1e-12) == 13
    assert np.count_nonzero(smoothed(impulse, 0.1, 60.0) > 1e-12) == 7
