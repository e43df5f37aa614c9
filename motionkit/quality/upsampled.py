"""The framerate at which a motion was captured, where its frames betray that it is lower than the file says.

Held frames are counted. Interpolation of any kind leaves a knot at every captured instant: between knots differences of
second or fourth order are those of a smooth curve, across them they are not, so their size pulses at the captured
framerate (in images: Gallagher, Detection of linear and cubic interpolation in JPEG compressed images, 2005).
"""

from functools import lru_cache

import numpy as np
from jaxtyping import Float, Float32, Float64

from motionkit.quality.knots import KNOTS, explained
from motionkit.timegrid import COMMON_FPS

MIN_FRAMES = 60
# A few joints say enough, and this many frames.
NUM_JOINTS = 8
MAX_FRAMES = 8192

# Captured rates that are looked for. The pulse of a rate above half of the file's appears folded, at their difference;
# below 8 Hz bodies pulse by themselves (the step's harmonics), so that nobody can tell 25 fps in a file at 30.
MIN_CAPTURED_FPS = 12.0
MIN_PULSE_HERTZ = 8.0
MAX_CAPTURED_SHARE = 0.9

# A pulse stands out of the spectrum around it by this factor (docs/results/quality.md), and knots at its rate explain
# that much of what happens faster than a tenth of a second.
MIN_PROMINENCE = 60.0
MIN_EXPLAINED = 0.15
ALIKE = 0.01
LINES_RATHER = 0.7
NEIGHBOURS = 15

# Differences that float32 positions of a few metres cannot tell from zero.
ROUNDING_METRES = 1e-6

# Held frames: at most this share is new, and the new ones come this regularly.
MAX_NEW_SHARE = 0.9
MIN_REGULAR = 0.95


def effective_fps(
    positions: Float32[np.ndarray, "frames joints 3"], moved: Float[np.ndarray, "steps"], fps: float
) -> float | None:
    """The framerate that the frames bear witness to: `fps`, or one of the rates of capture below it.

    `moved` is the longest step (m) of any joint between neighbouring frames, 0 where a frame is held. Of rates that
    explain the frames alike the highest is given: no more is claimed than is seen. None under 60 frames.
    """
    if len(positions) < MIN_FRAMES:
        return None
    held = _rate_of_held(moved, fps)
    if held is not None:
        return held
    few = positions[:MAX_FRAMES, :: max(1, positions.shape[1] // NUM_JOINTS)]
    difference = few.reshape(len(few), -1)
    second = np.diff(difference, n=2, axis=0)
    lines = _pulses(_log_energy(second, fps), 2, fps)
    curves = _pulses(_log_energy(np.diff(second, n=2, axis=0), fps), 4, fps)
    # Straight lines pulse in both, but only second differences tell which of two rates they join.
    found = lines if _best(lines) >= LINES_RATHER * _best(curves) else curves
    if _best(found) < MIN_EXPLAINED:
        return fps
    return max(rate for share, rate in found if share > _best(found) - ALIKE)


def _best(found: list[tuple[float, float]]) -> float:
    return max((share for share, _ in found), default=0.0)


def _rate_of_held(moved: Float[np.ndarray, "steps"], fps: float) -> float | None:
    # Every captured frame held for ⌊s⌋ or ⌈s⌉ frames. Stretches that are frozen for longer say nothing.
    gaps = np.diff(np.flatnonzero(moved > 0.0))
    if len(gaps) < MIN_FRAMES // 8:
        return None
    gaps = gaps[gaps <= 2.5 * gaps.mean()]
    spacing = float(gaps.mean())
    regular = float(np.mean((gaps == np.floor(spacing)) | (gaps == np.ceil(spacing))))
    if 1.0 / spacing > MAX_NEW_SHARE or regular < MIN_REGULAR:
        return None
    counted = fps / spacing
    known = [fps / factor for factor in range(2, 9)] + [float(rate) for rate in COMMON_FPS if rate.denominator < 1001]
    nearest = min(known, key=lambda rate: abs(rate - counted))
    return nearest if abs(nearest - counted) < 0.02 * counted else counted


@lru_cache(maxsize=64)
def _captured_rates(fps: float) -> tuple[float, ...]:
    # Whole fractions of the file's rate, and the rates at which cameras run that are none of these.
    fractions = [fps / factor for factor in range(2, 9)]
    others = (float(rate) for rate in COMMON_FPS if rate.denominator < 1001)
    rates = [*fractions, *(rate for rate in others if min(abs(rate - each) for each in fractions) > 0.005 * rate)]
    return tuple(rate for rate in rates if MIN_CAPTURED_FPS <= rate <= MAX_CAPTURED_SHARE * fps)


@lru_cache(maxsize=64)
def _pulsing_rates(fps: float) -> tuple[tuple[float, ...], Float64[np.ndarray, "rates"]]:
    # Those of the rates whose pulse can be seen, and its frequency in cycles a frame.
    rates = tuple(rate for rate in _captured_rates(fps) if min(rate % fps, -rate % fps) >= MIN_PULSE_HERTZ)
    return rates, np.array([min(rate % fps, -rate % fps) / fps for rate in rates])


def _log_energy(difference: Float32[np.ndarray, "rows values"], fps: float) -> Float64[np.ndarray, "rows"]:
    # What happens faster than a tenth of a second in the logarithm, in which strong and weak motion pulse alike.
    energy = np.einsum("tc,tc->t", difference, difference).astype(np.float64)
    logarithm = np.log(energy + difference.shape[1] * ROUNDING_METRES**2)
    return without_trend(logarithm, fps)


def without_trend(values: Float64[np.ndarray, "rows"], fps: float) -> Float64[np.ndarray, "rows"]:
    """Values less their running mean over a tenth of a second."""
    width = max(5, round(fps / 10) | 1)
    padded = np.concatenate(([0.0], np.full(width // 2, values[0]), values, np.full(width // 2, values[-1])))
    sums = np.cumsum(padded)
    return np.asarray(values - (sums[width:] - sums[:-width]) / width)


def _pulses(size: Float64[np.ndarray, "rows"], order: int, fps: float) -> list[tuple[float, float]]:
    # (share of the size that knots at the rate explain, rate) of the rates that stand out of the spectrum.
    rates, frequencies = _pulsing_rates(fps)
    spread = 1.5 * float(np.median(np.abs(size))) + 1e-9
    size = np.minimum(np.maximum(size, -4.0 * spread), 4.0 * spread)
    power = np.abs(np.fft.rfft(size * _window(len(size)))) ** 2
    chosen = np.flatnonzero(_prominence(power, frequencies * len(size)) > MIN_PROMINENCE)
    return [(max(explained(size, knot, rates[i], fps) for knot in KNOTS[order]), rates[i]) for i in chosen.tolist()]


@lru_cache(maxsize=8)
def _window(num_rows: int) -> Float64[np.ndarray, "rows"]:
    return np.hanning(num_rows)


def _prominence(
    power: Float64[np.ndarray, "frequencies"], places: Float64[np.ndarray, "rates"]
) -> Float64[np.ndarray, "rates"]:
    # The peaks at some frequencies over the means of their neighbourhoods.
    last = len(power) - 1
    centre = np.minimum(np.rint(places).astype(np.int64), last)
    reach = max(NEIGHBOURS, len(power) // 10)
    sums = np.concatenate(([0.0], np.cumsum(power)))
    low, inner_low = np.maximum(1, centre - reach), np.maximum(1, centre - 3)
    inner_high, high = np.minimum(len(power), centre + 4), np.minimum(len(power), centre + reach)
    high = np.maximum(high, inner_high)
    around = sums[inner_low] - sums[low] + sums[high] - sums[inner_high]
    count = inner_low - low + high - inner_high
    peak = np.maximum(np.maximum(power[centre - 1], power[centre]), power[np.minimum(centre + 1, last)])
    return np.asarray(peak / (around / np.maximum(count, 1) + 1e-30))
