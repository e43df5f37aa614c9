"""Adds rotations and rigid bones to fields of joint positions, for files that hold rotations (BVH).

Interpolators on positions move each joint independently, so bones shorten between frames that turn, and rotations are
unknown. Here the observed rotations are interpolated as well, and each joint is turned by the smallest rotation that
aligns its bones with the positions: bones keep their length, twists follow the observed frames, and observed frames
are unchanged.
"""

from dataclasses import dataclass

import numpy as np

from motionkit.core.kinematics import (
    fit_rotation,
    global_rotations,
    quaternion_between,
    quaternion_conjugate,
    quaternion_multiply,
    quaternion_rotate,
)
from motionkit.core.shapes import Float32
from motionkit.core.skeleton import Skeleton
from motionkit.fields.interpolation import INTERPOLATORS, Settling
from motionkit.fields.motion_field import DerivedField, Joints, MotionField, Observation, Poses, Times, at_fps

_FRAMES_TO_ESTIMATE_FROM = 500
_MOVING_METRES, _TURNING = 1e-4, 1e-6
_NO_LENGTH = 1e-6
# Negligible if the bones determine a joint's rotation, and enough if they are collinear.
_INERTIA = 1e-4


@dataclass(frozen=True)
class Rig:
    """The rigid structure of a body, estimated from its motion.

    `moving` joints translate in their parent's frame (hips that travel in a reference on the floor), `still` ones never
    rotate in it (or have no rotation channels).
    """

    skeleton: Skeleton
    moving: frozenset[int]
    still: frozenset[int]

    @classmethod
    def of(cls, observation: Observation) -> "Rig":
        """The rig of an observation with rotations, estimated from some hundred frames."""
        poses = observation.poses.rows(slice(None, None, max(1, len(observation) // _FRAMES_TO_ESTIMATE_FROM)))
        joints = Joints.of(poses, observation.skeleton)
        spread = np.ptp(joints.bones, axis=0).max(axis=-1)
        # q and −q are one rotation.
        turned = 1.0 - np.abs(np.sum(joints.rotations * joints.rotations[:1], axis=-1)).min(axis=0)
        return cls(
            observation.skeleton,
            frozenset(np.flatnonzero(spread > _MOVING_METRES).tolist()),
            frozenset(np.flatnonzero(turned < _TURNING).tolist()),
        )

    def carried(self, joint: int) -> tuple[int, ...]:
        """The joints fixed in a joint's frame: its children, and theirs if a child never rotates."""
        carried_joints, left = [], [joint]
        while left:
            children = [child for child in self.skeleton.children(left.pop()) if child not in self.moving]
            carried_joints += children
            left += [child for child in children if child in self.still]
        return tuple(carried_joints)


def on_bones(field: MotionField, observation: Observation) -> MotionField:
    """The field itself if it has rotations, else one with the bones of the observation (required).

    Joints without a rigid bone keep the field's positions, all others are placed along bones.
    """
    if field.query(np.array([field.start_seconds])).local_rotations is not None:
        return field
    own = Settling(INTERPOLATORS["slerp"]).encode(
        observation,
        before_seconds=max(0.0, observation.start_seconds - field.start_seconds),
        after_seconds=max(0.0, field.end_seconds - observation.end_seconds),
    )
    rig = Rig.of(observation)

    def on_rig(times: Times) -> Poses:
        aims = field.query(times).joint_positions
        poses = own.query(np.clip(times, own.start_seconds, own.end_seconds))
        positions, rotations = _pointed(poses, aims, rig)
        translation = None
        if poses.root_translation is not None:
            translation = poses.root_translation + positions[:, 0] - poses.joint_positions[:, 0]
        return Poses(positions, rotations, translation)

    return DerivedField(field, on_rig, lambda fps: on_bones(at_fps(field, fps), observation))


def _pointed(
    poses: Poses, targets: Float32[np.ndarray, "times joints 3"], rig: Rig
) -> tuple[Float32[np.ndarray, "times joints 3"], Float32[np.ndarray, "times joints 4"]]:
    assert poses.local_rotations is not None
    local, places = poses.local_rotations.astype(np.float64), poses.joint_positions.astype(np.float64)
    before = global_rotations(local, rig.skeleton)
    reached, world = targets.astype(np.float64), before.copy()
    turns = np.zeros_like(world)  # from the previous world rotation to the new one
    # Parents come before children, so that each bone is aimed from its joint's new position.
    for joint, parent in enumerate(rig.skeleton.parents):
        turn = turns[:, parent] if parent >= 0 else np.tile([1.0, 0.0, 0.0, 0.0], (len(world), 1))
        if parent >= 0 and joint not in rig.moving:
            reached[:, joint] = reached[:, parent] + quaternion_rotate(turn, places[:, joint] - places[:, parent])
        held = [] if joint in rig.still else list(rig.carried(joint))
        bones = quaternion_rotate(turn[:, None], places[:, held] - places[:, [joint]])
        long = np.abs(bones).max(axis=(0, 2), initial=0.0) > _NO_LENGTH
        bones, aims = bones[:, long], (targets[:, held] - reached[:, [joint]])[:, long]
        if bones.shape[1] == 1:
            turn = quaternion_multiply(quaternion_between(bones[:, 0], aims[:, 0]), turn)
        elif bones.shape[1]:
            turn = quaternion_multiply(fit_rotation(bones, aims, _INERTIA), turn)
        turns[:, joint], world[:, joint] = turn, quaternion_multiply(turn, before[:, joint])
        above = world[:, parent] if parent >= 0 else np.array([1.0, 0.0, 0.0, 0.0])
        local[:, joint] = quaternion_multiply(quaternion_conjugate(above), world[:, joint])
    local /= np.linalg.norm(local, axis=-1, keepdims=True)
    return reached.astype(np.float32), local.astype(np.float32)
