"""What the knots of an interpolation leave in the differences of its samples."""

from collections.abc import Callable
from fractions import Fraction

import numpy as np
from jaxtyping import Float64

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
