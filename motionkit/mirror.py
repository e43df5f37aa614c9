"""The mirror image of a motion: x ← −x, left and right joints exchanged, rotations with them."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float32, Int

from motionkit.motion import Motion
from motionkit.skeleton import Skeleton

FLIP = np.array([-1.0, 1.0, 1.0], dtype=np.float32)
# The reflection M = diag(−1, 1, 1) turns a rotation R into M·R·M, which turns the other way about y and z.
TURN_BACK = np.array([1.0, 1.0, -1.0, -1.0], dtype=np.float32)


def mirror(motion: Motion) -> Motion:
    """The mirror image in the plane x = 0, with its left and right joints exchanged; captions stay as they are.

    Rotations come with a mirrored skeleton, so that forward kinematics gives the mirrored positions exactly, also for a
    body that is not symmetric. Raises `ValueError` for a skeleton without left/right pairs, or whose pairs hang from
    joints that are none. Source of the rule: HumanML3D, raw_pose_processing.ipynb (`swap_left_right`).
    """
    order = _partners(motion.skeleton)
    rotations, root = motion.local_rotations, motion.root_translation
    mirrored = replace(
        motion,
        joint_positions=mirrored_positions(motion.joint_positions, motion.skeleton),
        skeleton=motion.skeleton if rotations is None else _mirrored_skeleton(motion.skeleton, order),
        local_rotations=None if rotations is None else rotations[:, order] * TURN_BACK,
        root_translation=None if root is None else root * FLIP,
    )
    return mirrored.logged("mirrored: x ← −x, left and right joints exchanged")


def mirrored_positions(
    joint_positions: Float32[np.ndarray, "frames joints 3"], skeleton: Skeleton
) -> Float32[np.ndarray, "frames joints 3"]:
    """The mirror image of joint positions alone. Raises `ValueError` as `mirror` does."""
    return joint_positions[:, _partners(skeleton)] * FLIP


def _partners(skeleton: Skeleton) -> Int[np.ndarray, "joints"]:
    if not skeleton.left_right_pairs:
        raise ValueError(f"skeleton {skeleton.name!r} does not say which joints are left and right")
    order = np.arange(skeleton.num_joints)
    for left, right in skeleton.left_right_pairs:
        order[left], order[right] = right, left
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0 and skeleton.parents[order[joint]] != order[parent]:
            names = skeleton.joint_names[joint], skeleton.joint_names[order[joint]]
            raise ValueError(f"skeleton {skeleton.name!r}: {names[0]} and {names[1]} hang from joints that are no pair")
    return order


def _mirrored_skeleton(skeleton: Skeleton, order: Int[np.ndarray, "joints"]) -> Skeleton:
    sites = {int(order[joint]): (-x + 0.0, y, z) for joint, (x, y, z) in skeleton.end_sites}
    # − 0 + 0 = 0: a symmetric skeleton is its own mirror image to the bit.
    return replace(
        skeleton,
        offsets=skeleton.offsets[order] * FLIP + np.float32(0.0),
        end_sites=tuple(sorted(sites.items())),
    )
