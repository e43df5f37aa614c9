"""Corrects a motion field so that it passes through the observed frames without jumps."""

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from motionkit.core.kinematics import (
    quaternion_conjugate,
    quaternion_multiply,
    quaternion_to_rotation_vector,
    rotation_vector_to_quaternion,
)
from motionkit.core.shapes import Float64
from motionkit.core.skeleton import Skeleton
from motionkit.fields.motion_field import (
    DerivedField,
    Joints,
    MotionEncoder,
    MotionField,
    Observation,
    Poses,
    Times,
    at_fps,
    check_times,
)

if TYPE_CHECKING:
    from scipy.interpolate import PchipInterpolator


@dataclass(frozen=True, eq=False)
class Anchored:
    """A `MotionEncoder` whose fields pass through every observed frame: another encoder's, corrected.

    What a field is off by at the observed times is spread between them by a monotone cubic (PCHIP: continuous velocity,
    no overshoot in a gap), stays as it is beyond both ends, and is taken away: from rotations (as rotation vectors),
    bones and root where field and observation both have rotations, else from joint positions.
    """

    encoder: MotionEncoder

    @property
    def name(self) -> str:
        """The encoder's name, marked as anchored."""
        return f"{self.encoder.name}, anchored"

    def encode(
        self, observation: Observation, *, before_seconds: float = 0.0, after_seconds: float = 0.0
    ) -> DerivedField:
        """The encoder's field, corrected to pass through the observed frames; raises what the encoder raises."""
        field = self.encoder.encode(observation, before_seconds=before_seconds, after_seconds=after_seconds)
        return anchored(field, observation)


def anchored(field: MotionField, observation: Observation) -> DerivedField:
    """A field corrected to pass through observed frames; raises `ValueError` if times or skeleton don't match."""
    skeleton = field.skeleton
    if skeleton.joint_names != observation.skeleton.joint_names:
        raise ValueError(
            f"the field is of skeleton {skeleton.name!r} ({skeleton.num_joints} joints), the observation of "
            f"{observation.skeleton.name!r} ({observation.skeleton.num_joints}): their joints must be the same"
        )
    check_times(field, observation.times_seconds)

    def on_rotations(poses: Poses) -> bool:
        return poses.local_rotations is not None and observation.poses.local_rotations is not None

    @cache
    def offsets() -> "PchipInterpolator":
        """What the field misses the observed poses by, as a function of time; constant beyond both ends."""
        from scipy.interpolate import PchipInterpolator

        times = observation.times_seconds
        poses, given = field.query(times), observation.poses
        if on_rotations(poses):
            missed = _missed(poses, given, skeleton)
        else:
            missed = (given.joint_positions.astype(np.float64) - poses.joint_positions).reshape(len(times), -1)
        # The end offsets again beyond the ends: there the slope becomes zero, so velocity stays continuous.
        knots = np.concatenate(([times[0] - 1.0], times, [times[-1] + 1.0]))
        return PchipInterpolator(knots, np.concatenate((missed[:1], missed, missed[-1:])))

    def corrected(times: Times) -> Poses:
        poses = field.query(times)
        steps = np.asarray(offsets()(np.clip(times, *offsets().x[[0, -1]])))
        if on_rotations(poses):
            return _with_offsets(poses, steps, skeleton)
        return Poses((poses.joint_positions + steps.reshape(poses.joint_positions.shape)).astype(np.float32))

    return DerivedField(field, corrected, lambda fps: anchored(at_fps(field, fps), observation))


def _missed(poses: Poses, given: Poses, skeleton: Skeleton) -> Float64[np.ndarray, "frames numbers"]:
    mine, theirs = Joints.of(poses, skeleton), Joints.of(given, skeleton)
    turns = quaternion_to_rotation_vector(quaternion_multiply(quaternion_conjugate(mine.rotations), theirs.rotations))
    missed = (turns, theirs.bones - mine.bones, (theirs.root - mine.root)[:, None])
    return np.concatenate(missed, axis=1).reshape(len(turns), -1)


def _with_offsets(poses: Poses, offsets: Float64[np.ndarray, "times numbers"], skeleton: Skeleton) -> Poses:
    count = skeleton.num_joints
    turns, bones, root = np.split(offsets.reshape(len(offsets), 2 * count + 1, 3), (count, 2 * count), axis=1)
    joints = Joints.of(poses, skeleton)
    rotations = quaternion_multiply(joints.rotations, rotation_vector_to_quaternion(turns))
    moved = Joints(rotations, joints.bones + bones, joints.root + root[:, 0])
    translation = poses.root_translation
    if translation is not None:
        translation = (translation + root[:, 0]).astype(np.float32)
    return Poses(moved.positions(skeleton), rotations.astype(np.float32), translation)
