"""Curves through rotations (SLERP, Catmull-Rom, SQUAD, cubic) and through plain values.

Beyond both ends all continue at constant angular velocity. Quaternions are (w, x, y, z), float64; rates are rotation
vectors per second in the joint's own frame.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from motionkit.core.kinematics import (
    continuous_quaternions,
    quaternion_conjugate,
    quaternion_multiply,
    quaternion_slerp,
    quaternion_to_rotation_vector,
    rotation_vector_to_quaternion,
)
from motionkit.core.shapes import Float, Float64, Int

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
    return {"linear": _linear, "catmull-rom": _catmull_rom_values, "cubic": _cubic_values}[kind](times_seconds, values)


def knot_rates(
    times_seconds: Float64[np.ndarray, "frames"], steps: Float64[np.ndarray, "segments *rest"]
) -> Float64[np.ndarray, "frames *rest"]:
    """Catmull-Rom rates per second at all knots, from the steps between them.

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


def _catmull_rom_values(times: Float64[np.ndarray, "frames"], values: Float64[np.ndarray, "frames *rest"]) -> Curve:
    from scipy.interpolate import CubicHermiteSpline

    rates = knot_rates(times, np.diff(values, axis=0))
    return Curve(CubicHermiteSpline(times, values, rates), float(times[0]), float(times[-1]))


def _cubic_values(times: Float64[np.ndarray, "frames"], values: Float64[np.ndarray, "frames *rest"]) -> Curve:
    from scipy.interpolate import CubicSpline

    return Curve(CubicSpline(times, values), float(times[0]), float(times[-1]))


RotationKind = Literal["slerp", "catmull-rom", "squad", "cubic"]

_Between = Callable[
    [Int[np.ndarray, "times"], Float64[np.ndarray, "times 1"]],
    Float64[np.ndarray, "times joints 4"],
]


@dataclass(frozen=True, eq=False)
class RotationCurve:
    """Rotations between knots by `between(segment, fraction of it)`, and the end rates beyond."""

    times_seconds: Float64[np.ndarray, "frames"]
    between: _Between
    end_rates: Float64[np.ndarray, "2 joints 3"]

    def __call__(self, times_seconds: Float64[np.ndarray, "times"]) -> Float64[np.ndarray, "times joints 4"]:
        """Unit quaternions at any times, in any order."""
        knots = self.times_seconds
        inside = np.clip(times_seconds, knots[0], knots[-1])
        segment = np.clip(np.searchsorted(knots, inside, side="right") - 1, 0, len(knots) - 2)
        fraction = (inside - knots[segment]) / (knots[segment + 1] - knots[segment])
        rotations = self.between(segment, fraction[:, None])
        beyond = times_seconds - inside
        outside = np.flatnonzero(beyond)
        if outside.size:
            rates = self.end_rates[(beyond[outside] > 0).astype(np.int64)]
            turned = rotation_vector_to_quaternion(rates * beyond[outside, None, None])
            rotations[outside] = quaternion_multiply(rotations[outside], turned)
        return rotations


def rotation_curve(
    kind: RotationKind, times_seconds: Float64[np.ndarray, "frames"], rotations: Float64[np.ndarray, "frames joints 4"]
) -> RotationCurve:
    """A curve through rotations at strictly increasing times; a single one is constant."""
    if len(rotations) == 1:
        times_seconds, rotations = times_seconds[0] + np.arange(2.0), np.repeat(rotations, 2, axis=0)
    rotations = continuous_quaternions(rotations)
    make = {"slerp": _slerp, "catmull-rom": _catmull_rom, "squad": _squad, "cubic": _cubic}[kind]
    return make(times_seconds, rotations)


def turns_between(rotations: Float64[np.ndarray, "frames joints 4"]) -> Float64[np.ndarray, "segments joints 3"]:
    """log(q_i⁻¹·q_{i+1}): the shortest rotation from each one to the next, in the joint's own frame, radians."""
    return quaternion_to_rotation_vector(quaternion_multiply(quaternion_conjugate(rotations[:-1]), rotations[1:]))


def _slerp(times: Float64[np.ndarray, "frames"], q: Float64[np.ndarray, "frames joints 4"]) -> RotationCurve:
    """Great arcs (Shoemake 1985)."""

    def between(
        segment: Int[np.ndarray, "times"], fraction: Float64[np.ndarray, "times 1"]
    ) -> Float64[np.ndarray, "times joints 4"]:
        return quaternion_slerp(q[segment], q[segment + 1], fraction)

    return RotationCurve(times, between, _outermost_rates(times, q))


def _catmull_rom(times: Float64[np.ndarray, "frames"], q: Float64[np.ndarray, "frames joints 4"]) -> RotationCurve:
    """Cubic Hermite quaternion curves (Kim, Kim & Shin 1995, Eq. 16) with Catmull-Rom's rates at the knots."""
    turns = turns_between(q)
    rates = knot_rates(times, turns) * (1.0 / 3.0)
    gaps = np.diff(times)[:, None, None]
    first, third = gaps * rates[:-1], gaps * rates[1:]
    exp = rotation_vector_to_quaternion
    middle = quaternion_multiply(quaternion_multiply(exp(-first), exp(turns)), exp(-third))
    second = quaternion_to_rotation_vector(middle)

    def between(
        segment: Int[np.ndarray, "times"], fraction: Float64[np.ndarray, "times 1"]
    ) -> Float64[np.ndarray, "times joints 4"]:
        u = fraction[..., None]
        result = quaternion_multiply(q[segment], exp(first[segment] * (1.0 - (1.0 - u) ** 3)))
        result = quaternion_multiply(result, exp(second[segment] * (u * u * (3.0 - 2.0 * u))))
        return quaternion_multiply(result, exp(third[segment] * u**3))

    return RotationCurve(times, between, _outermost_rates(times, q))


def _squad(times: Float64[np.ndarray, "frames"], q: Float64[np.ndarray, "frames joints 4"]) -> RotationCurve:
    """Spherical quadrangles (Shoemake 1987), with inner points that keep the rate continuous at uneven times too.

    SQUAD leaves q_i at (L_i + 2·log(q_i⁻¹·a_i))/h_i and reaches it at (L_{i−1} − 2·log(q_i⁻¹·b_i))/h_{i−1}; both are
    set to Catmull-Rom's rate at the knot. At even times a_i = b_i is Shoemake's inner point.
    """
    turns = turns_between(q)
    rates, gaps = knot_rates(times, turns), np.diff(times)[:, None, None]
    leaving = quaternion_multiply(q[:-1], rotation_vector_to_quaternion((gaps * rates[:-1] - turns) / 2.0))
    reaching = quaternion_multiply(q[1:], rotation_vector_to_quaternion((turns - gaps * rates[1:]) / 2.0))

    def between(
        segment: Int[np.ndarray, "times"], fraction: Float64[np.ndarray, "times 1"]
    ) -> Float64[np.ndarray, "times joints 4"]:
        chord = quaternion_slerp(q[segment], q[segment + 1], fraction)
        inner = quaternion_slerp(leaving[segment], reaching[segment], fraction)
        return quaternion_slerp(chord, inner, 2.0 * fraction * (1.0 - fraction))

    return RotationCurve(times, between, _outermost_rates(times, q))


def _cubic(times: Float64[np.ndarray, "frames"], q: Float64[np.ndarray, "frames joints 4"]) -> RotationCurve:
    """scipy's cubic rotation spline: continuous angular velocity and acceleration."""
    from scipy.spatial.transform import Rotation, RotationSpline

    splines = [RotationSpline(times, Rotation.from_quat(q[:, joint], scalar_first=True)) for joint in range(q.shape[1])]

    def between(
        segment: Int[np.ndarray, "times"], fraction: Float64[np.ndarray, "times 1"]
    ) -> Float64[np.ndarray, "times joints 4"]:
        instants = times[segment] + fraction[:, 0] * (times[segment + 1] - times[segment])
        result = np.stack([spline(instants).as_quat(scalar_first=True) for spline in splines], axis=1)
        # scipy's signs are arbitrary: the knot's are continuous.
        return result * np.where(np.sum(result * q[segment], axis=-1, keepdims=True) < 0, -1.0, 1.0)

    ends = np.stack([spline(times[[0, -1]], 1) for spline in splines], axis=1)
    return RotationCurve(times, between, ends)


def _outermost_rates(
    times: Float64[np.ndarray, "frames"], q: Float64[np.ndarray, "frames joints 4"]
) -> Float64[np.ndarray, "2 joints 3"]:
    first, last = turns_between(q[:2]) / (times[1] - times[0]), turns_between(q[-2:]) / (times[-1] - times[-2])
    return np.concatenate((first, last))
