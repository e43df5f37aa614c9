"""The mirror image of a motion: x ← −x, left and right joints exchanged, rotations with them."""

from dataclasses import replace

import numpy as np

from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32, Int
from motionkit.core.skeleton import Skeleton

FLIP = np.array([-1.0, 1.0, 1.0], dtype=np.float32)
# The reflection M = diag(−1, 1, 1) turns a rotation R into M·R·M, which turns the other way about y and z.
TURN_BACK = np.array([1.0, 1.0, -1.0, -1.0], dtype=np.float32)


def mirror(motion: Motion) -> Motion:
    """The mirror image in the plane x = 0, with left and right joints exchanged; captions are unchanged.

    Rotations come with a mirrored skeleton, so that forward kinematics gives the mirrored positions exactly, also for a
    body that is not symmetric. Raises `ValueError` for a skeleton without left/right pairs, or whose pairs hang from
    joints that are not a pair. Source of the rule: HumanML3D, raw_pose_processing.ipynb (`swap_left_right`).
    """
    order = _partners(motion.skeleton)
    rotations, root = motion.local_rotations, motion.root_translation
    mirrored = replace(
        motion,
        joint_positions=mirror_positions(motion.joint_positions, motion.skeleton.left_right_pairs),
        skeleton=motion.skeleton if rotations is None else _mirrored_skeleton(motion.skeleton, order),
        local_rotations=None if rotations is None else rotations[:, order] * TURN_BACK,
        root_translation=None if root is None else root * FLIP,
    )
    return mirrored.logged("mirrored: x ← −x, left and right joints exchanged")


def mirror_positions(
    joint_positions: Float32[np.ndarray, "*poses joints 3"], left_right_pairs: tuple[tuple[int, int], ...]
) -> Float32[np.ndarray, "*poses joints 3"]:
    """The mirror image of joint positions alone, of any number of poses."""
    return joint_positions[..., exchanged(joint_positions.shape[-2], left_right_pairs), :] * FLIP


def _partners(skeleton: Skeleton) -> Int[np.ndarray, "joints"]:
    if not skeleton.left_right_pairs:
        raise ValueError(f"skeleton {skeleton.name!r} does not say which joints are left and right")
    order = exchanged(skeleton.num_joints, skeleton.left_right_pairs)
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0 and skeleton.parents[order[joint]] != order[parent]:
            names = skeleton.joint_names[joint], skeleton.joint_names[order[joint]]
            raise ValueError(f"skeleton {skeleton.name!r}: {names[0]} and {names[1]} hang from joints that are no pair")
    return order


def exchanged(num_joints: int, left_right_pairs: tuple[tuple[int, int], ...]) -> Int[np.ndarray, "joints"]:
    """The joints in the order in which left and right are exchanged."""
    order = np.arange(num_joints)
    for left, right in left_right_pairs:
        order[left], order[right] = right, left
    return order


def _mirrored_skeleton(skeleton: Skeleton, order: Int[np.ndarray, "joints"]) -> Skeleton:
    sites = {int(order[joint]): (-x + 0.0, y, z) for joint, (x, y, z) in skeleton.end_sites}
    # − 0 + 0 = 0: a symmetric skeleton is its own mirror image to the bit.
    return replace(
        skeleton,
        offsets=skeleton.offsets[order] * FLIP + np.float32(0.0),
        end_sites=tuple(sorted(sites.items())),
    )
