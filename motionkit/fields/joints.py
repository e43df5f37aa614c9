"""Poses decomposed into rotations, bones and root, which can be interpolated without distorting the body."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from motionkit.core import kinematics
from motionkit.core.shapes import Float32, Float64
from motionkit.core.skeleton import Skeleton
from motionkit.fields.motion_field import Observation, Poses


@dataclass(frozen=True, eq=False)
class Joints:
    """Local rotations (w, x, y, z), bones in their parent's frame and the root's position, metres, float64.

    Bones are those observed, not the skeleton's rest offsets, so `positions` restores the poses exactly also where the
    rest offsets are not quite the source's, or where rotations come from inverse kinematics.
    """

    rotations: Float64[np.ndarray, "*frames joints 4"]
    bones: Float64[np.ndarray, "*frames joints 3"]
    root: Float64[np.ndarray, "*frames 3"]

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

    @classmethod
    def stacked(cls, each: "Sequence[Joints]") -> "Joints":
        """Several motions of as many frames along a second axis, so that one curve goes through all of them."""
        return cls(
            np.stack([joints.rotations for joints in each], axis=1),
            np.stack([joints.bones for joints in each], axis=1),
            np.stack([joints.root for joints in each], axis=1),
        )

    def positions(self, skeleton: Skeleton) -> Float32[np.ndarray, "*frames joints 3"]:
        """Forward kinematics, metres."""
        joints = skeleton.num_joints
        rotations, bones = self.rotations.reshape(-1, joints, 4), self.bones.reshape(-1, joints, 3)
        positions = kinematics.forward_kinematics(rotations, self.root.reshape(-1, 3), skeleton, bones)
        return positions.astype(np.float32).reshape(self.bones.shape)


def with_rotations(observation: Observation) -> Observation:
    """The observation itself if its poses have rotations, else with those of inverse kinematics in time."""
    poses = observation.poses
    if poses.local_rotations is not None:
        return observation
    rotations = kinematics.inverse_kinematics_in_time(poses.joint_positions, observation.skeleton).astype(np.float32)
    return replace(observation, poses=replace(poses, local_rotations=rotations))


def turned_rotations(
    rotations: Float32[np.ndarray, "times joints 4"],
    turned: dict[int, Float64[np.ndarray, "times 4"]],
    skeleton: Skeleton,
) -> Float32[np.ndarray, "times joints 4"]:
    """Local rotations of joints that `turned` in the world, and of their children that did not."""
    result = rotations.copy()
    old: dict[int, Float64[np.ndarray, "times 4"]] = {}
    for joint, parent in enumerate(skeleton.parents):
        if joint not in turned and parent not in turned:
            continue
        local = _world(old, joint, rotations, skeleton)
        if joint in turned:
            local = kinematics.quaternion_multiply(turned[joint], local)
        if parent >= 0:
            above = _world(old, parent, rotations, skeleton)
            if parent in turned:
                above = kinematics.quaternion_multiply(turned[parent], above)
            local = kinematics.quaternion_multiply(kinematics.quaternion_conjugate(above), local)
        result[:, joint] = local / np.linalg.norm(local, axis=-1, keepdims=True)
    return result


def _world(
    known: dict[int, Float64[np.ndarray, "times 4"]],
    joint: int,
    rotations: Float32[np.ndarray, "times joints 4"],
    skeleton: Skeleton,
) -> Float64[np.ndarray, "times 4"]:
    """A joint's world rotation, cached; only few are needed of a whole body."""
    if joint not in known:
        own, parent = rotations[:, joint].astype(np.float64), skeleton.parents[joint]
        if parent >= 0:
            own = kinematics.quaternion_multiply(_world(known, parent, rotations, skeleton), own)
        known[joint] = own
    return known[joint]
