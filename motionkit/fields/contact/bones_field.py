"""A motion field that projects another one onto given bone lengths."""

from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from motionkit.core.shapes import Float, Float32, Float64
from motionkit.core.skeleton import Skeleton
from motionkit.fields.contact.bones import Bones
from motionkit.fields.contact.planted import on_bones
from motionkit.fields.contact.predicted import contacts_of
from motionkit.fields.motion_field import MotionField, Poses, at_fps

SAMPLES = 200


@dataclass(frozen=True, eq=False)
class BonesField:
    """A `MotionField` of another one's positions, projected onto bones."""

    field: MotionField
    bones: Bones

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

    def at_fps(self, fps: Fraction) -> "BonesField":
        """The field for this framerate on the same bones."""
        return replace(self, field=at_fps(self.field, fps))

    def query(self, times_seconds: Float64[np.ndarray, "times"]) -> Poses:
        """Poses at any times inside the domain, in any order; raises `ValueError` outside it."""
        return on_bones(self.field.query(times_seconds), self.bones)

    def contacts(self, times_seconds: Float64[np.ndarray, "times"]) -> Float32[np.ndarray, "times 2 2"] | None:
        """The wrapped field's predicted contacts, if any."""
        return contacts_of(self.field, times_seconds)


def with_lengths(field: MotionField, lengths: Float[np.ndarray, "bones"]) -> MotionField:
    """A motion with these bone lengths, metres, from the second joint on.

    Unchanged if it has rotations: its bones are then its skeleton's.
    """
    poses = field.query(np.linspace(field.start_seconds, field.end_seconds, SAMPLES))
    if poses.local_rotations is not None:
        return field
    bones = Bones.of(poses.joint_positions, field.skeleton)
    own = np.linalg.norm(bones.offsets[1:], axis=-1, keepdims=True)
    offsets = bones.offsets.copy()
    offsets[1:] *= np.where(own > 0, lengths[:, None] / np.where(own > 0, own, 1.0), 1.0)
    return BonesField(field, replace(bones, offsets=offsets))
