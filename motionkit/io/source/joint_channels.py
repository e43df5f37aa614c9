"""The channels of animation files: local rotations, and translations of the joints that need them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from motionkit.core import kinematics
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32
from motionkit.core.skeleton import Skeleton
from motionkit.fields.contact.bones import Bones

# Animators expect rigid bones; above this position error every joint gets a translation of its own instead.
RIGID_METRES = 2e-3
BONE_SAMPLES = 1000


@dataclass(frozen=True, eq=False)
class JointChannels:
    """A motion on a skeleton: rotations of all joints, translations (metres, in the parent's frame) of some.

    The root always has a translation, its world position. The other joints rest at their offsets.
    """

    skeleton: Skeleton
    rotations: Float32[np.ndarray, "frames joints 4"]
    translations: Mapping[int, Float32[np.ndarray, "frames 3"]]


def joint_channels(motion: Motion) -> JointChannels:
    """The motion's rotations if it has them; else those of inverse kinematics on its bones.

    If rigid bones would miss a position by more than 2 mm, every joint gets a translation, so that forward kinematics
    always gives the positions.
    """
    if motion.local_rotations is not None and motion.root_translation is not None:
        return JointChannels(motion.skeleton, motion.local_rotations, {0: motion.root_translation})
    positions = motion.joint_positions
    skeleton = _with_observed_bones(motion)
    rotations = kinematics.inverse_kinematics(positions, skeleton)
    places = {0: positions[:, 0]}
    reached = kinematics.forward_kinematics(rotations, positions[:, 0], skeleton)
    if np.abs(reached - positions).max() <= RIGID_METRES:
        return JointChannels(skeleton, rotations, places)
    world = kinematics.global_rotations(rotations, skeleton)
    for joint, parent in enumerate(skeleton.parents[1:], start=1):
        back = kinematics.quaternion_conjugate(world[:, parent])
        places[joint] = kinematics.quaternion_rotate(back, positions[:, joint] - positions[:, parent])
    return JointChannels(skeleton, rotations, places)


def _with_observed_bones(motion: Motion) -> Skeleton:
    """The skeleton with the motion's own bones, rotated to their rest directions."""
    skeleton = motion.skeleton
    some = np.unique(np.linspace(0, motion.num_frames - 1, BONE_SAMPLES).astype(np.int64))
    bones = Bones.of(motion.joint_positions[some], skeleton)
    rest = skeleton.offsets.astype(np.float64)
    own = rest.copy()
    for joint in range(skeleton.num_joints):
        children = [
            child
            for child in skeleton.children(joint)
            if child not in bones.moving and np.any(np.abs(rest[child]) > 1e-6)
        ]
        if len(children) == 1:
            length = np.linalg.norm(bones.offsets[children[0]])
            own[children] *= length / np.linalg.norm(rest[children[0]])
        elif children:
            turn = kinematics.fit_rotation(bones.offsets[children], rest[None, children])
            own[children] = kinematics.quaternion_rotate(turn, bones.offsets[children])
    return replace(skeleton, offsets=own.astype(np.float32))
