"""Features of slow motion that predict the fast motion, on a 120 Hz grid.

Everything here uses finite filters, so each sample depends on `MARGIN` samples on either side and on nothing else.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from motionkit.core.shapes import Float, Float64

GRID_FPS = 120
MARGIN = 192
"""Samples on both sides that the filters below need, and a few more."""

EDGES_HZ = (10.0, 14.0, 20.0, 28.0, 40.0, 60.0)
NUM_BANDS = len(EDGES_HZ) - 1
BAND_REACH = 60
ENVELOPE_REACH = 4

SLOW_HZ, SLOW_REACH = 4.0, 45
"""Band where generated motion matches captures; up to 6 Hz would predict no better (docs/results/detail.md)."""
LOWEST_REACH = 120
ENERGY_REACH = 36
LAGS = (-10, -5, 0, 5, 10)

FEET = (7, 8, 10, 11)
WATCHED = (*FEET, 0, 15, 20, 21)
"""Feet, root, head and hands of the 22-joint layout: speed, vertical velocity and acceleration at five times."""
ENERGETIC = (0, 4, 5, 7, 8, 15, 18, 19, 20, 21)
"""Joints whose slow energy over 0.6 s is a feature too."""
HIPS_AND_SHOULDERS = ((1, 2), (16, 17))
NUM_FEATURES = len(LAGS) * (len(FEET) + 4 * len(WATCHED)) + len(ENERGETIC)


@dataclass(frozen=True, eq=False)
class SlowMotion:
    """The state of a body at every sample of a segment of the grid.

    `features` are logarithms of heights, speeds, accelerations and energies, and vertical velocities and
    accelerations below a limit; `facing` is the direction across the body, a unit vector (x, z).
    """

    features: Float64[np.ndarray, "instants features"]
    facing: Float64[np.ndarray, "instants 2"]


def with_ends(positions: Float[np.ndarray, "instants joints 3"], before: int, after: int) -> Float64[np.ndarray, "..."]:
    """Pads a motion on both ends by point reflection, which keeps velocity continuous."""
    if len(positions) == 1:
        return np.repeat(positions.astype(np.float64), 1 + before + after, axis=0)
    pad = ((before, after), (0, 0), (0, 0))
    return np.asarray(np.pad(positions.astype(np.float64), pad, mode="reflect", reflect_type="odd"))


def slow_motion(positions: Float64[np.ndarray, "padded joints 3"]) -> SlowMotion:
    """The state at all samples except `MARGIN` at both ends, for the 22 joints, in metres, y up."""
    from scipy.ndimage import minimum_filter1d

    slow = filtered(positions.reshape(len(positions), -1), low_pass(SLOW_HZ, SLOW_REACH)[None])[0]
    slow = slow.reshape(len(slow), *positions.shape[1:])
    velocity = np.gradient(slow, 1.0 / GRID_FPS, axis=0)
    acceleration = np.gradient(velocity, 1.0 / GRID_FPS, axis=0)
    watched, feet = list(WATCHED), list(FEET)
    lowest = minimum_filter1d(slow[:, feet, 1].min(axis=1), 2 * LOWEST_REACH + 1, mode="nearest")
    now = np.concatenate(
        (
            np.log(np.clip(slow[:, feet, 1] - lowest[:, None], 0.0, 0.5) + 0.02),
            np.log(np.linalg.norm(velocity[:, watched], axis=-1) + 0.05),
            np.arctan(velocity[:, watched, 1] / 0.5),
            np.arctan(acceleration[:, watched, 1] / 8.0),
            np.log(np.linalg.norm(acceleration[:, watched], axis=-1) + 0.5),
        ),
        axis=1,
    )
    energy = np.square(acceleration[:, list(ENERGETIC)]).sum(axis=-1)
    energy = filtered(energy, hann(ENERGY_REACH)[None])[0]
    here = slice(MARGIN - SLOW_REACH, len(slow) - (MARGIN - SLOW_REACH))
    lagged = [now[here.start + lag : here.stop + lag] for lag in LAGS]
    return SlowMotion(
        np.concatenate((*lagged, np.log(_inner(energy, MARGIN - SLOW_REACH - ENERGY_REACH) + 0.25)), axis=1),
        _facing(slow[here]),
    )


def band_motion(
    signals: Float64[np.ndarray, "padded columns"],
) -> Float64[np.ndarray, "bands instants columns"]:
    """Signals filtered into bands, at all samples except `BAND_REACH` at both ends."""
    return filtered(signals, band_filters())


def band_power(positions: Float64[np.ndarray, "padded joints 3"]) -> Float64[np.ndarray, "instants bands joints"]:
    """Squared displacement (m²) in every band, averaged over 0.07 s, except `MARGIN` samples at both ends."""
    bands = band_motion(positions.reshape(len(positions), -1))
    power = np.square(bands).reshape(*bands.shape[:2], -1, 3).sum(axis=-1)
    power = np.moveaxis(power, 0, 1).reshape(bands.shape[1], -1)
    smooth = filtered(power, hann(ENVELOPE_REACH)[None])[0]
    return _inner(smooth, MARGIN - BAND_REACH - ENVELOPE_REACH).reshape(-1, NUM_BANDS, positions.shape[1])


def filtered(
    signals: Float64[np.ndarray, "instants columns"], filters: Float64[np.ndarray, "filters taps"]
) -> Float64[np.ndarray, "filters inner columns"]:
    """Symmetric filters applied to signals, valid samples only."""
    import scipy.fft

    taps = filters.shape[1]
    size = scipy.fft.next_fast_len(len(signals), real=True)
    spectrum = scipy.fft.rfft(signals, n=size, axis=0)
    found = np.empty((len(filters), len(signals) - taps + 1, signals.shape[1]))
    for each, gain in zip(found, scipy.fft.rfft(filters, n=size, axis=1), strict=True):
        each[:] = scipy.fft.irfft(spectrum * gain[:, None], n=size, axis=0)[taps - 1 : len(signals)]
    return found


@cache
def low_pass(cutoff_hz: float, reach: int) -> Float64[np.ndarray, "taps"]:
    """A low-pass filter of 2 · reach + 1 taps, half amplitude at the cut-off."""
    taps = np.arange(-reach, reach + 1)
    kernel = np.sinc(2.0 * cutoff_hz / GRID_FPS * taps) * np.hamming(len(taps))
    return np.asarray(kernel / kernel.sum())


@cache
def hann(reach: int) -> Float64[np.ndarray, "taps"]:
    """Weights of a mean over 2 · reach + 1 samples."""
    window = np.hanning(2 * reach + 3)[1:-1]
    return np.asarray(window / window.sum())


@cache
def band_filters() -> Float64[np.ndarray, "bands taps"]:
    """Differences of low-pass filters; they add up to everything above the lowest edge."""
    whole = np.zeros(2 * BAND_REACH + 1)
    whole[BAND_REACH] = 1.0
    below = [*(low_pass(edge, BAND_REACH) for edge in EDGES_HZ[:-1]), whole]
    return np.diff(np.array(below), axis=0)


def to_body(
    vectors: Float64[np.ndarray, "*before instants joints 3"], facing: Float64[np.ndarray, "instants 2"]
) -> Float64[np.ndarray, "*before instants joints 3"]:
    """Rotates world vectors to the body's frame: across, up, ahead."""
    return _turned(vectors, facing[:, None, 0], facing[:, None, 1])


def to_world(
    vectors: Float64[np.ndarray, "*before instants joints 3"], facing: Float64[np.ndarray, "instants 2"]
) -> Float64[np.ndarray, "*before instants joints 3"]:
    """Rotates vectors of the body's frame to the world's."""
    return _turned(vectors, facing[:, None, 0], -facing[:, None, 1])


def _turned(
    vectors: Float64[np.ndarray, "*before instants joints 3"],
    cosine: Float64[np.ndarray, "instants 1"],
    sine: Float64[np.ndarray, "instants 1"],
) -> Float64[np.ndarray, "*before instants joints 3"]:
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack((x * cosine + z * sine, y, z * cosine - x * sine), axis=-1)


def _facing(positions: Float64[np.ndarray, "instants joints 3"]) -> Float64[np.ndarray, "instants 2"]:
    across = sum(positions[:, right] - positions[:, left] for left, right in HIPS_AND_SHOULDERS)[:, [0, 2]]
    return np.asarray(across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9))


def _inner(values: Float64[np.ndarray, "instants columns"], margin: int) -> Float64[np.ndarray, "inner columns"]:
    return values[margin : len(values) - margin]
