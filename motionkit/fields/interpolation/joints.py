"""Poses decomposed into rotations, bones and root, which can be interpolated without distorting the body."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from motionkit.core import kinematics
from motionkit.core.shapes import Float32, Float64
from motionkit.core.skeleton import Skeleton
from motionkit.fields.motion_field import Observation, Observed, Poses


@dataclass(frozen=True, eq=False)
class Joints:
    """Local rotations (w, x, y, z), bones in their parent's frame and the root's position, metres, float64.

    Bones are those observed, not the skeleton's rest offsets, so `positions` restores the poses exactly also where the
    rest offsets are not quite the source's, or where rotations come from inverse kinematics.
    """

    rotations: Float64[np.ndarray, "frames joints 4"]
    bones: Float64[np.ndarray, "frames joints 3"]
    root: Float64[np.ndarray, "frames 3"]

    @classmethod
    def of(cls, poses: Poses, skeleton: Skeleton) -> "Joints":
        """Decomposes poses; those without rotations, in chronological order, get them from inverse kinematics."""
        local = poses.local_rotations
        if local is None:
            local = kinematics.inverse_kinematics_in_time(poses.joint_positions, skeleton)
        rotations = local.astype(np.float64)
        positions = poses.joint_positions.astype(np.float64)
        parents = list(skeleton.parents[1:])
        world = kinematics.global_rotations(rotations, skeleton)
        bones = np.zeros_like(positions)
        bones[:, 1:] = kinematics.quaternion_rotate(
            kinematics.quaternion_conjugate(world[:, parents]), positions[:, 1:] - positions[:, parents]
        )
        return cls(rotations, bones, positions[:, 0])

    def positions(self, skeleton: Skeleton) -> Float32[np.ndarray, "frames joints 3"]:
        """Forward kinematics, metres."""
        return kinematics.forward_kinematics(self.rotations, self.root, skeleton, self.bones).astype(np.float32)


@dataclass(frozen=True, eq=False)
class JointsOfMany:
    """`Joints` of several motions over the same times, so that one curve goes through all of them at once."""

    rotations: Float64[np.ndarray, "frames motions joints 4"]
    bones: Float64[np.ndarray, "frames motions joints 3"]
    root: Float64[np.ndarray, "frames motions 3"]

    @classmethod
    def of(cls, observations: Sequence[Observation]) -> "JointsOfMany":
        """Decomposes all poses of motions of equal length, like `Joints.of`."""
        each = [Joints.of(observation.poses, observation.skeleton) for observation in observations]
        return cls(
            np.stack([joints.rotations for joints in each], axis=1),
            np.stack([joints.bones for joints in each], axis=1),
            np.stack([joints.root for joints in each], axis=1),
        )

    def positions(self, skeleton: Skeleton) -> Float32[np.ndarray, "frames motions joints 3"]:
        """Forward kinematics, metres."""
        frames, motions, joints = self.rotations.shape[:3]
        count = frames * motions
        flat = Joints(
            self.rotations.reshape(count, joints, 4), self.bones.reshape(count, joints, 3), self.root.reshape(count, 3)
        )
        return flat.positions(skeleton).reshape(frames, motions, joints, 3)


def with_rotations(observation: Observed) -> Observed:
    """The observation itself if its poses have rotations, else with those of inverse kinematics in time."""
    if observation.rows(slice(0, 1)).poses.local_rotations is not None:
        return observation
    skeleton = observation.skeleton
    return observation.remade(lambda some, before: rotations_in_time(some.poses, skeleton, before), skeleton)


def rotations_in_time(poses: Poses, skeleton: Skeleton, before: Poses | None) -> Poses:
    """Poses in chronological order with rotations from inverse kinematics, continuing from the pose `before`."""
    if before is None or before.local_rotations is None:
        rotations = kinematics.inverse_kinematics_in_time(poses.joint_positions, skeleton)
    else:
        both = np.concatenate((before.joint_positions, poses.joint_positions))
        rotations = kinematics.inverse_kinematics_in_time(both, skeleton, before.local_rotations[0])[1:]
    return Poses(poses.joint_positions, rotations.astype(np.float32), poses.root_translation)
