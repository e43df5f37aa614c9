"""Detects the framerate at which a motion was captured, if it is lower than the file's.

Held frames are counted. Interpolation of any kind leaves a knot at every captured instant: between knots differences of
second or fourth order are those of a smooth curve, across them they are not, so their size pulses at the captured
framerate (in images: Gallagher, Detection of linear and cubic interpolation in JPEG compressed images, 2005).
"""

from collections.abc import Callable
from fractions import Fraction
from functools import lru_cache

import numpy as np

from motionkit.core.framerate import COMMON_FPS
from motionkit.core.shapes import Float, Float32, Float64
from motionkit.features.quality.steps import middle

Kernel = Callable[[Float64[np.ndarray, "*shape"]], Float64[np.ndarray, "*shape"]]

# Energy between knots relative to that across them, where interpolation is exact and only rounding is left.
FLOOR = 1e-4
MIN_PHASES = 24
MAX_PHASES = 96


def _linear_spline(x: Float64[np.ndarray, "*shape"]) -> Float64[np.ndarray, "*shape"]:
    return np.asarray(np.maximum(0.0, 1.0 - np.abs(x)))


def _quadratic_spline(x: Float64[np.ndarray, "*shape"]) -> Float64[np.ndarray, "*shape"]:
    x = np.abs(x)
    return np.where(x < 0.5, 0.75 - x**2, 0.5 * np.maximum(0.0, 1.5 - x) ** 2)


def _cubic_spline(x: Float64[np.ndarray, "*shape"]) -> Float64[np.ndarray, "*shape"]:
    x = np.abs(x)
    return np.where(x < 1.0, 2 / 3 - x**2 + 0.5 * x**3, np.maximum(0.0, 2.0 - x) ** 3 / 6)


def _kink_in_fourth(x: Float64[np.ndarray, "*shape"]) -> Float64[np.ndarray, "*shape"]:
    return np.asarray(_linear_spline(x + 1) - 2 * _linear_spline(x) + _linear_spline(x - 1))


def _bend_in_fourth(x: Float64[np.ndarray, "*shape"]) -> Float64[np.ndarray, "*shape"]:
    return np.asarray(_quadratic_spline(x + 0.5) - _quadratic_spline(x - 0.5))


# The difference (of order 2 or 4) at a sample x frames after a knot at which the first, second or third derivative
# jumps: linear and SLERP, piecewise cubic through tangents, and cubic spline interpolation. They are B-splines and
# differences of these (de Boor: a divided difference of a truncated power is a B-spline).
KNOTS: dict[int, tuple[Kernel, ...]] = {
    2: (_linear_spline,),
    4: (_kink_in_fourth, _bend_in_fourth, _cubic_spline),
}


def explained(size: Float64[np.ndarray, "rows"], knot: Kernel, rate: float, fps: float) -> float:
    """Share of the variance of `size` (the log energy of differences) that knots at `rate` explain, best phase taken.

    The pattern may be weaker than that of exact interpolation, as noise or rotations make it, and not stronger: this is
    what tells 30 fps from the 90 that pulse alike in a file at 120.
    """
    spacing = fps / rate
    period = Fraction(spacing).limit_denominator(MIN_PHASES)
    num_phases = min(MAX_PHASES, period.numerator * -(-MIN_PHASES // period.numerator))
    place = np.arange(len(size)) + np.arange(num_phases)[:, None] * (spacing / num_phases)
    after = place % spacing
    reach = range(-int(3 / spacing) - 1, int(3 / spacing) + 2)
    energy = sum((knot(after - before * spacing) ** 2 for before in reach), start=np.zeros_like(after))
    pattern = np.log(energy + FLOOR)
    pattern -= pattern.mean(axis=1, keepdims=True)
    variance = np.einsum("pt,pt->p", pattern, pattern)
    slope = np.clip(pattern @ size / (variance + 1e-9), 0.0, 1.2)
    left = np.mean((size - slope[:, None] * pattern) ** 2, axis=1)
    return float(1.0 - left.min() / np.mean(size**2))


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
    """The estimated framerate of the capture: `fps`, or a lower one.

    `moved` is the longest step (m) of any joint between neighbouring frames, 0 for held frames. Of rates that explain
    the frames equally well the highest is returned. None under 60 frames.
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
    spread = 1.5 * middle(np.abs(size)) + 1e-9
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
