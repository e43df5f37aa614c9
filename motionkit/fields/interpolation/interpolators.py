"""The interpolators: between observed frames by a curve, beyond them at rest or at constant velocity.

All pass through every observed frame, at even or uneven times. Those on joint positions move each joint by itself, so
bones shorten between frames that turn; those on rotations keep bones, root and rotations apart. Beyond the observed
span `hold` stands still; all others go on at their end velocity: joints on straight lines (positions), or the root on a
straight line while every joint turns at a constant rate and bones keep their length (rotations).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np

from motionkit.core.motion import Motion
from motionkit.core.plain_text import suggestion
from motionkit.core.shapes import Float64
from motionkit.core.skeleton import Skeleton
from motionkit.fields.interpolation.curves import CurveKind, RotationKind, curve, rotation_curve
from motionkit.fields.interpolation.joints import Joints, JointsOfMany, with_rotations
from motionkit.fields.motion_field import (
    Observation,
    Observed,
    Poses,
    check_observed_alike,
    check_times,
    continuous_rotations,
)

Method = Literal["hold", "linear", "catmull-rom", "cubic", "slerp", "rotation-catmull-rom", "squad", "rotation-cubic"]
# Poses of several motions at the same times, a `Poses` for each motion.
PosesAt = Callable[[Float64[np.ndarray, "times"]], list[Poses]]

TIMES_AT_ONCE = 4096
# An instant this close to an observed one is that one: time stamps are rounded to float64, frames are not.
SNAP_SECONDS = 1e-8
FRAMES_AT_ONCE = 1024
BLOCKS_KEPT = 2
# The influence of a frame k frames away on a cubic spline is below 2⁻ᵏ: beyond 48 it vanishes in float64.
_SPLINE_MARGIN = 48
_TRAVELLING_METRES = 0.1


@dataclass(frozen=True, eq=False)
class InterpolatedField:
    """A `MotionField` through all frames of an observation, on its span and the requested extension.

    Curves are fitted on demand: to 1,024 frames and as many on both sides as have an influence there. So memory
    doesn't grow with the motion beyond the observation itself, and a pose depends on its time alone.
    """

    observation: Observed
    interpolator: "Interpolator"
    start_seconds: float
    end_seconds: float

    @property
    def skeleton(self) -> Skeleton:
        """The observation's skeleton."""
        return self.observation.skeleton

    def query(self, times_seconds: Float64[np.ndarray, "times"]) -> Poses:
        """Poses at any times inside the domain, in any order; raises `ValueError` outside it.

        Processes 4,096 times at once, so that it needs little more memory than its output.
        """
        check_times(self, times_seconds)
        times = _snapped(times_seconds, self.observation.times_seconds)
        segment = np.searchsorted(self.observation.times_seconds, times, side="right") - 1
        block = np.clip(segment, 0, max(0, len(self.observation) - 2)) // FRAMES_AT_ONCE
        result: Poses | None = None
        for number in np.unique(block).tolist() or [0]:
            rows, poses_at = np.flatnonzero(block == number), self._curves(number)
            for start in range(0, max(1, len(rows)), TIMES_AT_ONCE):
                some = rows[start : start + TIMES_AT_ONCE]
                (poses,) = poses_at(times[some])
                result = result or poses.room_for(len(times))
                result.put(some, poses)
        assert result is not None
        return result

    @cached_property
    def _curves(self) -> Callable[[int], PosesAt]:
        margin = self.interpolator.margin_frames

        @lru_cache(BLOCKS_KEPT)
        def curves(number: int) -> PosesAt:
            first = number * FRAMES_AT_ONCE
            frames = slice(max(0, first - margin), first + FRAMES_AT_ONCE + 1 + margin)
            return self.interpolator.make([self.observation.rows(frames)])

        return curves


@dataclass(frozen=True)
class Interpolator:
    """A `MotionEncoder` without training: curves through frames, and the number of neighbours that influence them.

    Also a `BatchEncoder`: motions observed at the same times share their curves.
    """

    name: Method
    make: Callable[[Sequence[Observation]], PosesAt] = field(repr=False)
    margin_frames: int

    def encode(
        self, observation: Observed, *, before_seconds: float = 0.0, after_seconds: float = 0.0
    ) -> InterpolatedField:
        """The field through all observed frames; raises `ValueError` for a negative reach."""
        if not (0 <= before_seconds < np.inf and 0 <= after_seconds < np.inf):
            raise ValueError(f"seconds to extend by must be 0 or more, not {before_seconds:g} and {after_seconds:g}")
        return InterpolatedField(
            observation.remade(continuous_rotations, observation.skeleton),
            self,
            observation.start_seconds - before_seconds,
            observation.end_seconds + after_seconds,
        )

    def query_many(
        self, observations: Sequence[Observation], times_seconds: Float64[np.ndarray, "times"]
    ) -> list[Poses]:
        """Poses of each motion at the same times, inside the observed span or beyond it, as its own field gives them.

        Raises `ValueError` for motions that are not observed at the same times, or have other joints.
        """
        check_observed_alike(observations)
        times = _snapped(times_seconds, observations[0].times_seconds)
        continuous = [observation.remade(continuous_rotations, observation.skeleton) for observation in observations]
        return self.make(continuous)(times)


def interpolate(motion: Motion, method: Method = "slerp") -> InterpolatedField:
    """A motion as a field, from its first frame to its last."""
    return interpolator_of(method).encode(Observation.of(motion))


def interpolator_of(method: Method) -> "Interpolator":
    """The interpolator of a name; raises `ValueError` for any other name."""
    if method not in INTERPOLATORS:
        near = suggestion(str(method), INTERPOLATORS)
        raise ValueError(f"method is {method!r}, expected one of {', '.join(INTERPOLATORS)}{near}")
    return INTERPOLATORS[method]


def _hold(observations: Sequence[Observation]) -> PosesAt:
    """Each pose until the next one (zero-order hold)."""

    def poses_at(times: Float64[np.ndarray, "times"]) -> list[Poses]:
        rows = np.maximum(np.searchsorted(observations[0].times_seconds, times, side="right") - 1, 0)
        return [observation.poses.rows(rows) for observation in observations]

    return poses_at


def _on_positions(kind: CurveKind) -> Callable[[Sequence[Observation]], PosesAt]:
    def make(observations: Sequence[Observation]) -> PosesAt:
        observed = np.stack([observation.poses.joint_positions for observation in observations], axis=1)
        positions = curve(kind, observations[0].times_seconds, observed)

        def poses_at(times: Float64[np.ndarray, "times"]) -> list[Poses]:
            made = positions(times).astype(np.float32)
            return [Poses(np.ascontiguousarray(made[:, motion])) for motion in range(len(observations))]

        return poses_at

    return make


def _on_rotations(rotation_kind: RotationKind, root_kind: CurveKind) -> Callable[[Sequence[Observation]], PosesAt]:
    """Interpolates rotations, from inverse kinematics if there are none; the field has rotations only if observed."""

    def make(observations: Sequence[Observation]) -> PosesAt:
        times_seconds, skeleton = observations[0].times_seconds, observations[0].skeleton
        joints = JointsOfMany.of(observations)
        # Joints of all motions side by side.
        shape = joints.rotations.shape[1:]
        rotations = rotation_curve(rotation_kind, times_seconds, joints.rotations.reshape(len(times_seconds), -1, 4))
        bones = curve(root_kind, times_seconds, joints.bones)
        # Hips that travel in a reference on the floor continue like a root; bones keep their last length.
        travels = np.ptp(joints.bones, axis=0).max(axis=-1) > _TRAVELLING_METRES
        root = curve(root_kind, times_seconds, joints.root)
        translations = [
            None
            if observation.poses.root_translation is None
            else curve(root_kind, times_seconds, observation.poses.root_translation)
            for observation in observations
        ]

        def poses_at(times: Float64[np.ndarray, "times"]) -> list[Poses]:
            turned = rotations(times).reshape(len(times), *shape)
            bones_then = bones.clamped(times)
            if travels.any():
                bones_then[:, travels] = bones(times)[:, travels]
            positions = JointsOfMany(turned, bones_then, root(times)).positions(skeleton)
            return [
                Poses(
                    joint_positions=np.ascontiguousarray(positions[:, motion]),
                    local_rotations=(
                        None if observation.poses.local_rotations is None else turned[:, motion].astype(np.float32)
                    ),
                    root_translation=None if translation is None else translation(times).astype(np.float32),
                )
                for motion, (observation, translation) in enumerate(zip(observations, translations, strict=True))
            ]

        return poses_at

    return make


INTERPOLATORS: dict[Method, Interpolator] = {
    interpolator.name: interpolator
    for interpolator in (
        Interpolator("hold", _hold, 0),
        Interpolator("linear", _on_positions("linear"), 0),
        Interpolator("catmull-rom", _on_positions("catmull-rom"), 1),
        Interpolator("cubic", _on_positions("cubic"), _SPLINE_MARGIN),
        Interpolator("slerp", _on_rotations("slerp", "linear"), 0),
        Interpolator("rotation-catmull-rom", _on_rotations("catmull-rom", "catmull-rom"), 1),
        Interpolator("squad", _on_rotations("squad", "catmull-rom"), 1),
        Interpolator("rotation-cubic", _on_rotations("cubic", "cubic"), _SPLINE_MARGIN),
    )
}


def _snapped(
    times: Float64[np.ndarray, "times"], observed: Float64[np.ndarray, "frames"]
) -> Float64[np.ndarray, "times"]:
    after = np.searchsorted(observed, times)
    above = observed[np.minimum(after, len(observed) - 1)]
    below = observed[np.maximum(after - 1, 0)]
    nearest = np.where(np.abs(times - below) < np.abs(times - above), below, above)
    return np.where(np.abs(times - nearest) < SNAP_SECONDS, nearest, times)


JOINTS_SECONDS, ROOT_SECONDS = 0.2, 1.0


@dataclass(frozen=True)
class Settling:
    """A `MotionEncoder`: an interpolator on rotations between frames, coming to rest before and after them."""

    interpolator: Interpolator
    joints_seconds: float = JOINTS_SECONDS
    root_seconds: float = ROOT_SECONDS

    @property
    def name(self) -> str:
        """The interpolator's name."""
        return self.interpolator.name

    def encode(
        self, observation: Observed, *, before_seconds: float = 0.0, after_seconds: float = 0.0
    ) -> "SettlingField | InterpolatedField":
        """The field through all observed frames; raises `ValueError` for a negative reach."""
        between = self.interpolator.encode(observation, before_seconds=before_seconds, after_seconds=after_seconds)
        if not (before_seconds or after_seconds):
            return between
        longest = max(self.joints_seconds, self.root_seconds)
        beyond = self.interpolator.encode(
            with_rotations(observation),
            before_seconds=min(before_seconds, longest),
            after_seconds=min(after_seconds, longest),
        )
        return SettlingField(self, between, beyond)


@dataclass(frozen=True, eq=False)
class SettlingField:
    """`between` inside the observed span; outside it `beyond`, which has rotations, at slowed times."""

    encoder: Settling
    between: InterpolatedField
    beyond: InterpolatedField

    @property
    def skeleton(self) -> Skeleton:
        """The observation's skeleton."""
        return self.between.skeleton

    @property
    def start_seconds(self) -> float:
        """First instant of the domain."""
        return self.between.start_seconds

    @property
    def end_seconds(self) -> float:
        """Last instant of the domain."""
        return self.between.end_seconds

    def query(self, times_seconds: Float64[np.ndarray, "times"]) -> Poses:
        """Poses at any times inside the domain, in any order; raises `ValueError` outside it."""
        check_times(self, times_seconds)
        observation = self.between.observation
        inside = np.clip(times_seconds, observation.start_seconds, observation.end_seconds)
        outside = np.flatnonzero(inside != times_seconds)
        poses = self.between.query(inside)
        if outside.size:
            poses.put(outside, self._settled(inside[outside], (times_seconds - inside)[outside], poses))
        return poses

    def _settled(self, ends: Float64[np.ndarray, "times"], reach: Float64[np.ndarray, "times"], like: Poses) -> Poses:
        def slowed(seconds: float) -> Poses:
            way = seconds * -np.expm1(-np.abs(reach) / seconds)
            return self.beyond.query(
                np.clip(ends + np.sign(reach) * way, self.beyond.start_seconds, self.beyond.end_seconds)
            )

        limbs, path = slowed(self.encoder.joints_seconds), slowed(self.encoder.root_seconds)
        assert limbs.local_rotations is not None
        # A bone that travels, hips in a reference on the floor, is a part of the path.
        travelled = Joints.of(path, self.skeleton)
        joints = Joints(Joints.of(limbs, self.skeleton).rotations, travelled.bones, travelled.root)
        return Poses(
            joints.positions(self.skeleton),
            None if like.local_rotations is None else limbs.local_rotations,
            None if like.root_translation is None else path.root_translation,
        )
