"""What animation files hold of a motion: local rotations, and translations of the joints that need them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float32

from motionkit.core import kinematics
from motionkit.core.motion import Motion
from motionkit.core.skeleton import Skeleton

# A position that rigid bones miss by more gets a translation of its own.
RIGID_METRES = 1e-4


@dataclass(frozen=True, eq=False)
class JointChannels:
    """A motion on a skeleton: rotations of all joints, translations (metres, in the parent's frame) of some.

    The root always has a translation, its world position. The other joints rest at their offsets.
    """

    skeleton: Skeleton
    rotations: Float32[np.ndarray, "frames joints 4"]
    translations: Mapping[int, Float32[np.ndarray, "frames 3"]]


def joint_channels(motion: Motion) -> JointChannels:
    """True rotations where the motion has them; else inverse kinematics on bones of their median observed length.

    Where rigid bones would miss the positions by more than 0.1 mm, every joint gets a translation, so that forward
    kinematics gives the positions in any case.
    """
    if motion.local_rotations is not None and motion.root_translation is not None:
        return JointChannels(motion.skeleton, motion.local_rotations, {0: motion.root_translation})
    positions = motion.joint_positions
    skeleton = _with_observed_lengths(motion)
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


def _with_observed_lengths(motion: Motion) -> Skeleton:
    skeleton = motion.skeleton
    parents = [max(parent, 0) for parent in skeleton.parents]
    bones = motion.joint_positions - motion.joint_positions[:, parents]
    observed = np.median(np.linalg.norm(bones, axis=-1), axis=0)
    rest = np.linalg.norm(skeleton.offsets, axis=-1)
    scale = np.where(rest > 1e-6, observed / np.maximum(rest, 1e-6), 1.0).astype(np.float32)
    scale[0] = 1.0
    return replace(skeleton, offsets=skeleton.offsets * scale[:, None])
