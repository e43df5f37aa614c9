"""The interpolators: between observed frames by a curve, beyond them at rest or at constant velocity.

All pass through every observed frame, at even or uneven times. Those on joint positions move each joint by itself, so
bones shorten between frames that turn; those on rotations keep bones, root and rotations apart. Beyond the observed
span `hold` stands still; all others go on at their end velocity: joints on straight lines (positions), or the root on a
straight line while every joint turns at a constant rate and bones keep their length (rotations).

Quaternions are (w, x, y, z), float64; their rates are rotation vectors per second in the joint's own frame.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from motionkit.core.errors import suggestion
from motionkit.core.kinematics import (
    continuous_quaternions,
    quaternion_conjugate,
    quaternion_multiply,
    quaternion_slerp,
    quaternion_to_rotation_vector,
    rotation_vector_to_quaternion,
)
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float, Float64, Int
from motionkit.core.skeleton import Skeleton
from motionkit.fields.motion_field import (
    DerivedField,
    Joints,
    Observation,
    Poses,
    Times,
    check_observed_alike,
    check_times,
    continuous_rotations,
    query_in_blocks,
    with_rotations,
)

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

Method = Literal["hold", "linear", "catmull-rom", "cubic", "slerp", "rotation-catmull-rom", "squad", "rotation-cubic"]
CurveKind = Literal["linear", "catmull-rom", "cubic"]
RotationKind = Literal["slerp", "catmull-rom", "squad", "cubic"]

Knots = Float64[np.ndarray, "frames"]
Quaternions = Float64[np.ndarray, "frames joints 4"]
Segments = Int[np.ndarray, "times"]
Fractions = Float64[np.ndarray, "times 1"]

# An instant this close to an observed one is that one: time stamps are rounded to float64, frames are not.
SNAP_SECONDS = 1e-8
_TRAVELLING_METRES = 0.1


@dataclass(frozen=True, eq=False)
class Curve:
    """A piecewise polynomial between its first and last knot, and its end velocities beyond."""

    polynomial: "PPoly"

    def __call__(self, times_seconds: Times) -> Float64[np.ndarray, "times *rest"]:
        """Values at any times, in any order."""
        values = self.clamped(times_seconds)
        ends = np.clip(times_seconds, *self.polynomial.x[[0, -1]])
        outside = np.flatnonzero(ends != times_seconds)
        if outside.size:
            beyond = (times_seconds - ends)[outside].reshape(-1, *(1,) * (values.ndim - 1))
            values[outside] += beyond * np.asarray(self.polynomial(ends[outside], 1))
        return values

    def clamped(self, times_seconds: Times) -> Float64[np.ndarray, "times *rest"]:
        """Values at any times, the end values beyond both ends."""
        return np.asarray(self.polynomial(np.clip(times_seconds, *self.polynomial.x[[0, -1]])))


def curve(kind: CurveKind, times_seconds: Knots, values: Float[np.ndarray, "frames *rest"]) -> Curve:
    """A curve through `values` at strictly increasing times; a single one is constant."""
    from scipy.interpolate import CubicHermiteSpline, CubicSpline, PPoly

    values, times = values.astype(np.float64), times_seconds
    if len(values) == 1:
        polynomial = PPoly(values[None], np.array([times[0], times[0] + 1.0]))
    elif kind == "linear":
        slopes = np.diff(values, axis=0) / np.diff(times).reshape(-1, *(1,) * (values.ndim - 1))
        polynomial = PPoly(np.stack((slopes, values[:-1])), times)
    elif kind == "catmull-rom":
        polynomial = CubicHermiteSpline(times, values, knot_rates(times, np.diff(values, axis=0)))
    else:
        polynomial = CubicSpline(times, values)
    return Curve(polynomial)


def inner_rates(gaps: Any, slopes: Any) -> Any:
    """Catmull-Rom rates at all knots but the outer two: the slope of the parabola through a knot and its neighbours.

    Works on numpy arrays and torch tensors, whose first axis are the segments: their lengths `gaps` in seconds, even or
    not, and their `slopes` per second. Source: Barry & Goldman 1988 (the derivative of their recursion at a knot).
    """
    return (gaps[1:] * slopes[:-1] + gaps[:-1] * slopes[1:]) / (gaps[1:] + gaps[:-1])


def knot_rates(
    times_seconds: Knots, steps: Float64[np.ndarray, "segments *rest"]
) -> Float64[np.ndarray, "frames *rest"]:
    """Catmull-Rom rates per second at all knots, from the steps between them; at both ends those of the outer steps."""
    gaps = np.diff(times_seconds).reshape(-1, *(1,) * (steps.ndim - 1))
    slopes = steps / gaps
    return np.concatenate((slopes[:1], inner_rates(gaps, slopes), slopes[-1:]))


# Rotations [times, joints, 4] inside segments [times], at a fraction of each [times, 1].
Between = Callable[[Segments, Fractions], np.ndarray]


@dataclass(frozen=True, eq=False)
class RotationCurve:
    """Rotations between knots by `between(segment, fraction of it)`, and the end rates beyond."""

    times_seconds: Knots
    between: Between
    end_rates: Float64[np.ndarray, "2 joints 3"]

    def __call__(self, times_seconds: Times) -> Float64[np.ndarray, "times joints 4"]:
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
            turns = rotation_vector_to_quaternion(rates * beyond[outside, None, None])
            rotations[outside] = quaternion_multiply(rotations[outside], turns)
        return rotations


def rotation_curve(kind: RotationKind, times_seconds: Knots, rotations: Quaternions) -> RotationCurve:
    """A curve through rotations at strictly increasing times; a single one is constant."""
    times = times_seconds
    if len(rotations) == 1:
        times, rotations = times[0] + np.arange(2.0), np.repeat(rotations, 2, axis=0)
    q = continuous_quaternions(rotations)
    if kind == "cubic":
        return _rotation_spline(times, q)
    if kind == "slerp":  # great arcs (Shoemake 1985)
        ends = [_turns(q[:2]) / (times[1] - times[0]), _turns(q[-2:]) / (times[-1] - times[-2])]
        return RotationCurve(
            times,
            lambda segment, fraction: quaternion_slerp(q[segment], q[segment + 1], fraction),
            np.concatenate(ends),
        )
    turns = _turns(q)
    rates = knot_rates(times, turns)
    between = (_catmull_rom if kind == "catmull-rom" else _squad)(q, turns, rates, np.diff(times))
    return RotationCurve(times, between, rates[[0, -1]])


def _turns(q: Quaternions) -> Float64[np.ndarray, "segments joints 3"]:
    """log(q_i⁻¹·q_{i+1}): the shortest rotation from each one to the next, in the joint's own frame, radians."""
    return quaternion_to_rotation_vector(quaternion_multiply(quaternion_conjugate(q[:-1]), q[1:]))


def _catmull_rom(
    q: Quaternions,
    turns: Float64[np.ndarray, "segments joints 3"],
    rates: Float64[np.ndarray, "frames joints 3"],
    gaps: Float64[np.ndarray, "segments"],
) -> Between:
    """Cubic Hermite quaternion curves (Kim, Kim & Shin 1995, Eq. 16) with Catmull-Rom's rates at the knots."""
    exp, lengths, thirds = rotation_vector_to_quaternion, gaps[:, None, None], rates * (1.0 / 3.0)
    first, third = lengths * thirds[:-1], lengths * thirds[1:]
    middle = quaternion_multiply(quaternion_multiply(exp(-first), exp(turns)), exp(-third))
    second = quaternion_to_rotation_vector(middle)

    def between(segment: Segments, fraction: Fractions) -> np.ndarray:
        u = fraction[..., None]
        result = quaternion_multiply(q[segment], exp(first[segment] * (1.0 - (1.0 - u) ** 3)))
        result = quaternion_multiply(result, exp(second[segment] * (u * u * (3.0 - 2.0 * u))))
        return quaternion_multiply(result, exp(third[segment] * u**3))

    return between


def _squad(
    q: Quaternions,
    turns: Float64[np.ndarray, "segments joints 3"],
    rates: Float64[np.ndarray, "frames joints 3"],
    gaps: Float64[np.ndarray, "segments"],
) -> Between:
    """Spherical quadrangles (Shoemake 1987), with inner points that keep the rate continuous at uneven times too.

    SQUAD leaves q_i at (L_i + 2·log(q_i⁻¹·a_i))/h_i and reaches it at (L_{i−1} − 2·log(q_i⁻¹·b_i))/h_{i−1}; both are
    set to Catmull-Rom's rate at the knot. At even times a_i = b_i is Shoemake's inner point.
    """
    lengths = gaps[:, None, None]
    leaving = quaternion_multiply(q[:-1], rotation_vector_to_quaternion((lengths * rates[:-1] - turns) / 2.0))
    reaching = quaternion_multiply(q[1:], rotation_vector_to_quaternion((turns - lengths * rates[1:]) / 2.0))

    def between(segment: Segments, fraction: Fractions) -> np.ndarray:
        chord = quaternion_slerp(q[segment], q[segment + 1], fraction)
        inner = quaternion_slerp(leaving[segment], reaching[segment], fraction)
        return quaternion_slerp(chord, inner, 2.0 * fraction * (1.0 - fraction))

    return between


def _rotation_spline(times: Knots, q: Quaternions) -> RotationCurve:
    """scipy's cubic rotation spline: continuous angular velocity and acceleration."""
    from scipy.spatial.transform import Rotation, RotationSpline

    splines = [RotationSpline(times, Rotation.from_quat(q[:, joint], scalar_first=True)) for joint in range(q.shape[1])]

    def between(segment: Segments, fraction: Fractions) -> np.ndarray:
        instants = times[segment] + fraction[:, 0] * (times[segment + 1] - times[segment])
        result = np.stack([spline(instants).as_quat(scalar_first=True) for spline in splines], axis=1)
        # scipy's signs are arbitrary: the knot's are continuous.
        return result * np.where(np.sum(result * q[segment], axis=-1, keepdims=True) < 0, -1.0, 1.0)

    return RotationCurve(times, between, np.stack([spline(times[[0, -1]], 1) for spline in splines], axis=1))


# Poses of several motions at the same times, a `Poses` for each motion.
PosesAt = Callable[[Times], list[Poses]]


@dataclass(frozen=True, eq=False)
class InterpolatedField:
    """A `MotionField` through all frames of an observation, on its span and the requested extension."""

    observation: Observation
    interpolator: "Interpolator"
    start_seconds: float
    end_seconds: float

    @property
    def skeleton(self) -> Skeleton:
        """The observation's skeleton."""
        return self.observation.skeleton

    def query(self, times_seconds: Times) -> Poses:
        """Poses at any times inside the domain, in any order; raises `ValueError` outside it."""
        check_times(self, times_seconds)
        times = _snapped(times_seconds, self.observation.times_seconds)
        return query_in_blocks(lambda some: self._poses_at(some)[0], times)

    @cached_property
    def _poses_at(self) -> PosesAt:
        return self.interpolator.fit([continuous_rotations(self.observation)])


@dataclass(frozen=True)
class Interpolator:
    """A `MotionEncoder` without training: curves through frames.

    Also a `BatchEncoder`: motions observed at the same times share their curves.
    """

    name: Method
    fit: Callable[[Sequence[Observation]], PosesAt] = field(repr=False)

    def encode(
        self, observation: Observation, *, before_seconds: float = 0.0, after_seconds: float = 0.0
    ) -> InterpolatedField:
        """The field through all observed frames; raises `ValueError` for a negative reach."""
        if not (0 <= before_seconds < np.inf and 0 <= after_seconds < np.inf):
            raise ValueError(f"seconds to extend by must be 0 or more, not {before_seconds:g} and {after_seconds:g}")
        start, end = observation.start_seconds - before_seconds, observation.end_seconds + after_seconds
        return InterpolatedField(observation, self, start, end)

    def query_many(self, observations: Sequence[Observation], times_seconds: Times) -> list[Poses]:
        """Poses of each motion at the same times, inside the observed span or beyond it, as its own field gives them.

        Raises `ValueError` for motions that are not observed at the same times, or have other joints.
        """
        check_observed_alike(observations)
        times = _snapped(times_seconds, observations[0].times_seconds)
        return self.fit([continuous_rotations(observation) for observation in observations])(times)


def interpolate(motion: Motion, method: Method = "slerp") -> InterpolatedField:
    """A motion as a field, from its first frame to its last."""
    return interpolator_of(method).encode(Observation.of(motion))


def interpolator_of(method: Method) -> Interpolator:
    """The interpolator of a name; raises `ValueError` for any other name."""
    if method not in INTERPOLATORS:
        near = suggestion(str(method), INTERPOLATORS)
        raise ValueError(f"method is {method!r}, expected one of {', '.join(INTERPOLATORS)}{near}")
    return INTERPOLATORS[method]


def _hold(observations: Sequence[Observation]) -> PosesAt:
    """Each pose until the next one (zero-order hold)."""

    def poses_at(times: Times) -> list[Poses]:
        rows = np.maximum(np.searchsorted(observations[0].times_seconds, times, side="right") - 1, 0)
        return [observation.poses.rows(rows) for observation in observations]

    return poses_at


def _on_positions(kind: CurveKind, observations: Sequence[Observation]) -> PosesAt:
    observed = np.stack([observation.poses.joint_positions for observation in observations], axis=1)
    positions = curve(kind, observations[0].times_seconds, observed)

    def poses_at(times: Times) -> list[Poses]:
        sampled = positions(times).astype(np.float32)
        return [Poses(np.ascontiguousarray(sampled[:, motion])) for motion in range(len(observations))]

    return poses_at


def _on_rotations(rotation_kind: RotationKind, root_kind: CurveKind, observations: Sequence[Observation]) -> PosesAt:
    """Interpolates rotations, from inverse kinematics if there are none; the field has rotations only if observed."""
    times_seconds, skeleton = observations[0].times_seconds, observations[0].skeleton
    joints = Joints.stacked([Joints.of(observation.poses, observation.skeleton) for observation in observations])
    # Joints of all motions side by side.
    shape = joints.rotations.shape[1:]
    rotations = rotation_curve(rotation_kind, times_seconds, joints.rotations.reshape(len(times_seconds), -1, 4))
    bones = curve(root_kind, times_seconds, joints.bones)
    # Hips that travel in a reference on the floor continue like a root; bones keep their last length.
    travels = np.ptp(joints.bones, axis=0).max(axis=-1) > _TRAVELLING_METRES
    root = curve(root_kind, times_seconds, joints.root)
    translations = [
        None if each.poses.root_translation is None else curve(root_kind, times_seconds, each.poses.root_translation)
        for each in observations
    ]

    def poses_at(times: Times) -> list[Poses]:
        turned = rotations(times).reshape(len(times), *shape)
        bones_then = bones.clamped(times)
        if travels.any():
            bones_then[:, travels] = bones(times)[:, travels]
        positions = Joints(turned, bones_then, root(times)).positions(skeleton)
        return [
            Poses(
                np.ascontiguousarray(positions[:, motion]),
                None if observation.poses.local_rotations is None else turned[:, motion].astype(np.float32),
                None if translation is None else translation(times).astype(np.float32),
            )
            for motion, (observation, translation) in enumerate(zip(observations, translations, strict=True))
        ]

    return poses_at


INTERPOLATORS: dict[Method, Interpolator] = {
    interpolator.name: interpolator
    for interpolator in (
        Interpolator("hold", _hold),
        Interpolator("linear", partial(_on_positions, "linear")),
        Interpolator("catmull-rom", partial(_on_positions, "catmull-rom")),
        Interpolator("cubic", partial(_on_positions, "cubic")),
        Interpolator("slerp", partial(_on_rotations, "slerp", "linear")),
        Interpolator("rotation-catmull-rom", partial(_on_rotations, "catmull-rom", "catmull-rom")),
        Interpolator("squad", partial(_on_rotations, "squad", "catmull-rom")),
        Interpolator("rotation-cubic", partial(_on_rotations, "cubic", "cubic")),
    )
}


def _snapped(times: Times, observed: Knots) -> Times:
    after = np.searchsorted(observed, times)
    above = observed[np.minimum(after, len(observed) - 1)]
    below = observed[np.maximum(after - 1, 0)]
    nearest = np.where(np.abs(times - below) < np.abs(times - above), below, above)
    return np.where(np.abs(times - nearest) < SNAP_SECONDS, nearest, times)


# Joints and root travel on by what they would in so many seconds at the end's velocity.
JOINTS_SECONDS, ROOT_SECONDS = 0.2, 1.0


@dataclass(frozen=True)
class Settling:
    """A `MotionEncoder`: an interpolator on rotations between frames, coming to rest before and after them."""

    interpolator: Interpolator

    @property
    def name(self) -> str:
        """The interpolator's name."""
        return self.interpolator.name

    def encode(
        self, observation: Observation, *, before_seconds: float = 0.0, after_seconds: float = 0.0
    ) -> DerivedField | InterpolatedField:
        """The field through all observed frames; raises `ValueError` for a negative reach."""
        between = self.interpolator.encode(observation, before_seconds=before_seconds, after_seconds=after_seconds)
        if not (before_seconds or after_seconds):
            return between
        beyond = self.interpolator.encode(
            with_rotations(observation),
            before_seconds=min(before_seconds, ROOT_SECONDS),
            after_seconds=min(after_seconds, ROOT_SECONDS),
        )

        def settling(times: Times) -> Poses:
            inside = np.clip(times, observation.start_seconds, observation.end_seconds)
            outside = np.flatnonzero(inside != times)
            poses = between.query(inside)
            if outside.size:
                poses.put(outside, _settled(beyond, inside[outside], (times - inside)[outside], poses))
            return poses

        return DerivedField(between, settling)


def _settled(beyond: InterpolatedField, ends: Times, reach: Times, like: Poses) -> Poses:
    """Poses `reach` seconds beyond the ends: those of `beyond`, which has rotations, at slowed times."""

    def slowed(seconds: float) -> Poses:
        way = seconds * -np.expm1(-np.abs(reach) / seconds)
        return beyond.query(np.clip(ends + np.sign(reach) * way, beyond.start_seconds, beyond.end_seconds))

    limbs, path = slowed(JOINTS_SECONDS), slowed(ROOT_SECONDS)
    assert limbs.local_rotations is not None
    # A bone that travels, hips in a reference on the floor, belongs to the path.
    travelled = Joints.of(path, beyond.skeleton)
    joints = Joints(Joints.of(limbs, beyond.skeleton).rotations, travelled.bones, travelled.root)
    return Poses(
        joints.positions(beyond.skeleton),
        None if like.local_rotations is None else limbs.local_rotations,
        None if like.root_translation is None else path.root_translation,
    )
