"""Curves through the numbers of rotation rows: what "linear" and "cubic" mean to a model of poses as vectors."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from motionkit.core.kinematics import matrix_to_quaternion
from motionkit.core.skeleton import Skeleton
from motionkit.features.rotation_rows import closest_rotations, two_columns
from motionkit.fields.interpolation.curves import CurveKind, curve
from motionkit.fields.interpolation.joints import JointsOfMany
from motionkit.fields.motion_field import Observation, Observed, Poses, check_observed_alike, check_times


@dataclass(frozen=True)
class RowCurves:
    """An encoder by curves through root position and two columns of each rotation, made perpendicular again.

    Beyond the observed span numbers go on at constant velocity. It does not depend on what else is asked, but on the
    skeleton's rest pose, for a joint's first column counts for more than its second.
    """

    name: str
    kind: CurveKind

    def encode(
        self, observation: Observed, *, before_seconds: float = 0.0, after_seconds: float = 0.0
    ) -> "RowCurveField":
        """The field through all observed frames; raises `ValueError` for a negative reach."""
        if not (0 <= before_seconds < np.inf and 0 <= after_seconds < np.inf):
            raise ValueError(f"seconds beyond a motion are 0 or more, not {before_seconds:g} and {after_seconds:g}")
        reach = (observation.start_seconds - before_seconds, observation.end_seconds + after_seconds)
        return RowCurveField(self, observation.rows(slice(None)), *reach)

    def query_many(
        self, observations: Sequence[Observation], times_seconds: Float64[np.ndarray, "times"]
    ) -> list[Poses]:
        """Poses of many motions at the same times; see `motionkit.fields.motion_field.BatchEncoder`."""
        check_observed_alike(observations)
        joints = JointsOfMany.of(observations)
        observed = observations[0].times_seconds
        columns = curve(self.kind, observed, two_columns(joints.rotations))(times_seconds)
        rotations = matrix_to_quaternion(closest_rotations(columns))
        bones = curve(self.kind, observed, joints.bones).clamped(times_seconds)
        root = curve(self.kind, observed, joints.root)(times_seconds)
        positions = JointsOfMany(rotations, bones, root).positions(observations[0].skeleton)
        return [
            Poses(np.ascontiguousarray(positions[:, motion]), rotations[:, motion].astype(np.float32))
            for motion in range(len(observations))
        ]


@dataclass(frozen=True, eq=False)
class RowCurveField:
    """The `MotionField` of `RowCurves`."""

    encoder: RowCurves
    observation: Observation
    start_seconds: float
    end_seconds: float

    @property
    def skeleton(self) -> Skeleton:
        """The observation's skeleton."""
        return self.observation.skeleton

    def query(self, times_seconds: Float64[np.ndarray, "times"]) -> Poses:
        """Poses at any times inside the domain, in any order; raises `ValueError` outside it."""
        check_times(self, times_seconds)
        (poses,) = self.encoder.query_many([self.observation], times_seconds)
        return poses


LINEAR = RowCurves("row-linear", "linear")
CUBIC = RowCurves("row-cubic", "cubic")
