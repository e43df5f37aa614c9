"""Interpolators that come to rest beyond the ends of what is observed, for motions that are shown and not scored.

At constant velocity, which is the interpolators' own continuation, joints go on turning for ever. Here time slows down:
a joint turns on by what it would in `joints_seconds`, the root travels on by what it would in `root_seconds`, both at
first with the velocity that they had. Bodies stop moving their limbs sooner than they stop travelling, and so it is
nearer to captures than constant velocity at every reach (docs/complete.md).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from motionkit.interpolation.fields import InterpolatedField, Interpolator
from motionkit.interpolation.joints import Joints, with_rotations
from motionkit.motionfield import Observed, Poses, check_times
from motionkit.skeleton import Skeleton

JOINTS_SECONDS, ROOT_SECONDS = 0.2, 1.0


@dataclass(frozen=True)
class Settling:
    """A `MotionEncoder`: an interpolator on rotations between frames, coming to rest before and after them."""

    interpolator: Interpolator
    joints_seconds: float = JOINTS_SECONDS
    root_seconds: float = ROOT_SECONDS

    @property
    def name(self) -> str:
        """The interpolator's: between frames it is that."""
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
    """`between` inside the observed span; outside it `beyond`, which has rotations, asked at slowed times."""

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
