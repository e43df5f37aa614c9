"""Curves through vectors: straight lines, Catmull-Rom, cubic spline; beyond both ends all keep their velocity."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import Float, Float64

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

CurveKind = Literal["linear", "catmull-rom", "cubic"]


@dataclass(frozen=True, eq=False)
class Curve:
    """A piecewise polynomial on [first_seconds, last_seconds], and its end velocities beyond."""

    polynomial: "PPoly"
    first_seconds: float
    last_seconds: float

    def __call__(self, times_seconds: Float64[np.ndarray, "times"]) -> Float64[np.ndarray, "times *rest"]:
        """Values at any times, in any order."""
        values, beyond = self.clamped(times_seconds), self._beyond(times_seconds)
        outside = np.flatnonzero(beyond)
        if outside.size:
            ends = np.clip(times_seconds[outside], self.first_seconds, self.last_seconds)
            velocity = np.asarray(self.polynomial(ends, 1))
            values[outside] += beyond[outside].reshape(-1, *(1,) * (values.ndim - 1)) * velocity
        return values

    def clamped(self, times_seconds: Float64[np.ndarray, "times"]) -> Float64[np.ndarray, "times *rest"]:
        """Values at any times, the end values beyond both ends."""
        return np.asarray(self.polynomial(np.clip(times_seconds, self.first_seconds, self.last_seconds)))

    def _beyond(self, times: Float64[np.ndarray, "times"]) -> Float64[np.ndarray, "times"]:
        return np.asarray(times - np.clip(times, self.first_seconds, self.last_seconds))


def curve(
    kind: CurveKind, times_seconds: Float64[np.ndarray, "frames"], values: Float[np.ndarray, "frames *rest"]
) -> Curve:
    """A curve through `values` at strictly increasing times; a single one is constant."""
    values = values.astype(np.float64)
    if len(values) == 1:
        return _constant(times_seconds, values)
    return {"linear": _linear, "catmull-rom": _catmull_rom, "cubic": _cubic}[kind](times_seconds, values)


def knot_rates(
    times_seconds: Float64[np.ndarray, "frames"], steps: Float64[np.ndarray, "segments *rest"]
) -> Float64[np.ndarray, "frames *rest"]:
    """Rates per second at all knots from the steps between them, as Catmull-Rom splines take them.

    Inside, the slope of the parabola through three neighbours, so uneven times are allowed for; at both ends that of
    the outermost step. Source: Barry & Goldman 1988 (the derivative of their recursion at a knot).
    """
    gaps = np.diff(times_seconds).reshape(-1, *(1,) * (steps.ndim - 1))
    slopes = steps / gaps
    inner = (gaps[1:] * slopes[:-1] + gaps[:-1] * slopes[1:]) / (gaps[1:] + gaps[:-1])
    return np.concatenate((slopes[:1], inner, slopes[-1:]))


def _constant(times: Float64[np.ndarray, "frames"], values: Float64[np.ndarray, "frames *rest"]) -> Curve:
    from scipy.interpolate import PPoly

    return Curve(PPoly(values[None], np.array([times[0], times[0] + 1.0])), float(times[0]), float(times[0]))


def _linear(times: Float64[np.ndarray, "frames"], values: Float64[np.ndarray, "frames *rest"]) -> Curve:
    from scipy.interpolate import PPoly

    slopes = np.diff(values, axis=0) / np.diff(times).reshape(-1, *(1,) * (values.ndim - 1))
    return Curve(PPoly(np.stack((slopes, values[:-1])), times), float(times[0]), float(times[-1]))


def _catmull_rom(times: Float64[np.ndarray, "frames"], values: Float64[np.ndarray, "frames *rest"]) -> Curve:
    from scipy.interpolate import CubicHermiteSpline

    rates = knot_rates(times, np.diff(values, axis=0))
    return Curve(CubicHermiteSpline(times, values, rates), float(times[0]), float(times[-1]))


def _cubic(times: Float64[np.ndarray, "frames"], values: Float64[np.ndarray, "frames *rest"]) -> Curve:
    from scipy.interpolate import CubicSpline

    return Curve(CubicSpline(times, values), float(times[0]), float(times[-1]))
