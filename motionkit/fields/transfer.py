"""Other skeletons for encoders of the 22-joint layout: the correction is transferred, not the pose.

The source skeleton is interpolated on its own rotations. In the 22-joint layout the model's field is compared with the
same interpolator's: the world rotation of each joint (ΔG = G_model·G_interpolated⁻¹) and the pelvis' displacement.
World rotations do not depend on rest poses, so the source joints are turned by the same ΔG and the root is moved by
the same displacement. Bones keep their length; joints without a counterpart (fingers, a tail) keep their interpolated
local rotations; where the model agrees with the interpolator, nothing changes.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from motionkit.core.kinematics import global_rotations, quaternion_conjugate, quaternion_multiply
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float64
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.skeletons.mapping import PELVIS, counterpart_joints, map_joints
from motionkit.core.timegrid import TimeGrid
from motionkit.fields.interpolation import INTERPOLATORS
from motionkit.fields.motion_field import (
    DerivedField,
    Joints,
    MotionEncoder,
    MotionField,
    Observation,
    Poses,
    Times,
    at_fps,
    query_in_blocks,
    with_rotations,
)
from motionkit.fields.rig import Rig


@dataclass(frozen=True)
class Transferred:
    """Adapts a `MotionEncoder` for the 22 joints to every skeleton that `motionkit.core.skeletons.mapping` knows.

    `interpolator` makes the source skeleton's field, and the one that the model is compared with. `encoder` has to
    pass through observed frames (`motionkit.fields.anchoring`), or given frames move.
    """

    encoder: MotionEncoder
    interpolator: MotionEncoder = INTERPOLATORS["rotation-cubic"]

    @property
    def name(self) -> str:
        """The encoder's name."""
        return self.encoder.name

    def encode(
        self, observation: Observation, *, before_seconds: float = 0.0, after_seconds: float = 0.0
    ) -> DerivedField:
        """The source skeleton's field; raises `SkeletonMapError` for an unknown skeleton, and the encoder's errors."""
        counterparts = counterpart_joints(observation.skeleton)
        own = with_rotations(observation)
        canonical = canonical_observation(observation)
        moving, above = Rig.of(own).moving, own.skeleton.path_to_root(counterparts[PELVIS])
        reach = {"before_seconds": before_seconds, "after_seconds": after_seconds}
        return _corrected(
            own_field=self.interpolator.encode(own, **reach),
            model_field=self.encoder.encode(canonical, **reach),
            base_field=self.interpolator.encode(canonical, **reach),
            counterparts=counterparts,
            # The joint nearest the pelvis whose bone is not rigid, else the root.
            moved_joint=next((joint for joint in above if joint in moving), 0),
            like=observation.poses.rows(slice(0, 0)),
        )


def _corrected(
    own_field: MotionField,
    model_field: MotionField,
    base_field: MotionField,
    counterparts: Mapping[int, int],
    moved_joint: int,
    like: Poses,
) -> DerivedField:
    """The source skeleton's interpolated field, corrected by the difference of `model` and `base` in 22 joints.

    `counterparts` maps joints of the 22 to source ones; `moved_joint` is the source joint that carries the body's path.
    `like` is an observation without poses, the template of the output.
    """

    def poses(times: Times) -> Poses:
        own, model, base = (field.query(times) for field in (own_field, model_field, base_field))
        skeleton = own_field.skeleton
        joints = Joints.of(own, skeleton)
        turns = quaternion_multiply(_world(model, model_field.skeleton), quaternion_conjugate(_world(base, SMPL22)))
        before = global_rotations(joints.rotations, skeleton)
        after = before.copy()
        local = joints.rotations.copy()
        canonical_of = {own_joint: joint for joint, own_joint in counterparts.items()}
        for joint, parent in enumerate(skeleton.parents):
            if joint in canonical_of:
                after[:, joint] = quaternion_multiply(turns[:, canonical_of[joint]], before[:, joint])
            elif parent >= 0:
                after[:, joint] = quaternion_multiply(after[:, parent], joints.rotations[:, joint])
            if parent >= 0:
                local[:, joint] = quaternion_multiply(quaternion_conjugate(after[:, parent]), after[:, joint])
            else:
                local[:, joint] = after[:, joint]
        local /= np.linalg.norm(local, axis=-1, keepdims=True)
        turned = Joints(local, joints.bones, joints.root).positions(skeleton)
        pelvis = counterparts[PELVIS]
        target = own.joint_positions[:, pelvis] + (model.joint_positions - base.joint_positions)[:, PELVIS]
        move = (target - turned[:, pelvis])[:, None]
        carried = np.isin(np.arange(skeleton.num_joints), skeleton.subtree(moved_joint))
        positions = turned + np.where(carried[:, None], move, np.float32(0.0))
        translation = None
        if like.root_translation is not None:
            assert own.root_translation is not None
            translation = own.root_translation + positions[:, 0] - own.joint_positions[:, 0]
        rotations = None if like.local_rotations is None else local.astype(np.float32)
        return Poses(positions.astype(np.float32), rotations, translation)

    # At another framerate the model is sampled at that.
    return DerivedField(
        own_field,
        lambda times: query_in_blocks(poses, times),
        lambda fps: _corrected(own_field, at_fps(model_field, fps), base_field, counterparts, moved_joint, like),
    )


def canonical_observation(observation: Observation) -> Observation:
    """An observation of any known skeleton in the 22-joint layout, with rotations and its own bone lengths.

    Rotations are its own if its joints are the layout's; else those of inverse kinematics in time, from the layout's
    rest pose. Raises `SkeletonMapError`.
    """
    poses = observation.poses
    if observation.skeleton.joint_names == SMPL22.joint_names and poses.local_rotations is not None:
        return observation
    grid = TimeGrid(Fraction(1), len(observation))  # its times don't matter to a map
    motion = Motion(poses.joint_positions, observation.skeleton, grid, poses.local_rotations)
    positions = map_joints(motion, SMPL22.name).astype(np.float32)
    return with_rotations(Observation(observation.times_seconds, Poses(positions, None, positions[:, 0]), SMPL22))


def _world(poses: Poses, skeleton: Skeleton) -> Float64[np.ndarray, "times joints 4"]:
    return global_rotations(Joints.of(poses, skeleton).rotations, skeleton)
