"""Corrects a motion field so that it passes through the observed frames without jumps."""

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
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
from motionkit.fields.joints import Joints
from motionkit.fields.motion_field import (
    MotionEncoder,
    MotionField,
    Observation,
    Poses,
    at_fps,
    check_skeleton,
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
    ) -> "AnchoredField":
        """The encoder's field, corrected to pass through the observed frames; raises what the encoder raises."""
        field = self.encoder.encode(observation, before_seconds=before_seconds, after_seconds=after_seconds)
        return anchored(field, observation)


@dataclass(frozen=True, eq=False)
class AnchoredField:
    """A field plus what it misses the observed frames by, interpolated."""

    field: MotionField
    observation: Observation

    @property
    def skeleton(self) -> Skeleton:
        """Same as the wrapped field's."""
        return self.field.skeleton

    @property
    def start_seconds(self) -> float:
        """Same as the wrapped field's."""
        return self.field.start_seconds

    @property
    def end_seconds(self) -> float:
        """Same as the wrapped field's."""
        return self.field.end_seconds

    def at_fps(self, fps: Fraction) -> "AnchoredField":
        """The field for this framerate, anchored again."""
        return anchored(at_fps(self.field, fps), self.observation)

    def query(self, times_seconds: Float64[np.ndarray, "times"]) -> Poses:
        """Poses at any times inside the domain, in any order; raises `ValueError` outside it."""
        poses = self.field.query(times_seconds)
        offsets = np.asarray(self._offsets(np.clip(times_seconds, *self._offsets.x[[0, -1]])))
        if self._on_rotations(poses):
            return _with_offsets(poses, offsets, self.skeleton)
        return Poses((poses.joint_positions + offsets.reshape(poses.joint_positions.shape)).astype(np.float32))

    def _on_rotations(self, poses: Poses) -> bool:
        return poses.local_rotations is not None and self.observation.poses.local_rotations is not None

    @cached_property
    def _offsets(self) -> "PchipInterpolator":
        """What the field misses the observed poses by, as a function of time; constant beyond both ends."""
        from scipy.interpolate import PchipInterpolator

        observed, times = self.observation, self.observation.times_seconds
        poses = self.field.query(times)
        on_rotations = self._on_rotations(poses)
        offsets = _missed(poses, observed, self.skeleton) if on_rotations else _missed_positions(poses, observed)
        # The end offsets again beyond the ends: there the slope becomes zero, so velocity stays continuous.
        knots = np.concatenate(([times[0] - 1.0], times, [times[-1] + 1.0]))
        return PchipInterpolator(knots, np.concatenate((offsets[:1], offsets, offsets[-1:])))


def anchored(field: MotionField, observation: Observation) -> AnchoredField:
    """A field corrected to pass through observed frames; raises `ValueError` if times or skeleton don't match."""
    check_skeleton(field, observation)
    check_times(field, observation.times_seconds)
    return AnchoredField(field, observation)


def _missed_positions(made: Poses, given: Observation) -> Float64[np.ndarray, "frames numbers"]:
    moves = given.poses.joint_positions.astype(np.float64) - made.joint_positions
    return np.asarray(moves.reshape(len(moves), -1))


def _missed(made: Poses, given: Observation, skeleton: Skeleton) -> Float64[np.ndarray, "frames numbers"]:
    mine, theirs = Joints.of(made, skeleton), Joints.of(given.poses, skeleton)
    turns = quaternion_to_rotation_vector(quaternion_multiply(quaternion_conjugate(mine.rotations), theirs.rotations))
    parts = (turns, theirs.bones - mine.bones, (theirs.root - mine.root)[:, None])
    return np.concatenate(parts, axis=1).reshape(len(turns), -1)


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
