"""Raw joints → the joints that HumanML3D and KIT files hold: one skeleton, on the floor, at the origin, facing Z+.

Each step is a pure function; `process` is all four in the published order. They are steps of a whole clip: processing a
crop is not cropping what was processed. Source: HumanML3D, motion_representation.ipynb.
"""

from functools import cache

import numpy as np
from jaxtyping import Float, Float32

from motionkit.features.bones import bone_tree
from motionkit.features.layout import PoseLayout, facing_direction, pose_layout


def bone_lengths(pose: Float[np.ndarray, "joints 3"], layout: str) -> Float32[np.ndarray, "joints"]:
    """Length of the bone that ends in each joint of one pose; 0 for the root."""
    lengths = np.zeros(len(pose), dtype=np.float32)
    lengths[1:] = np.linalg.norm(pose[1:] - pose[bone_tree(layout).start], axis=-1)
    return lengths


@cache
def standard_bone_lengths(layout: str) -> Float32[np.ndarray, "joints"]:
    """The published target: the bone lengths of clip 000021 for `smpl22`, the layout's own skeleton otherwise."""
    lengths = np.asarray(np.linalg.norm(pose_layout(layout).skeleton.offsets, axis=-1), dtype=np.float32)
    lengths.flags.writeable = False
    return lengths


def uniform_skeleton(
    joint_positions: Float[np.ndarray, "frames joints 3"], layout: str, target: Float[np.ndarray, "joints"]
) -> Float32[np.ndarray, "frames joints 3"]:
    """The same bone directions with the target's bone lengths; the root's path is scaled by the ratio of leg lengths.

    The source's leg is measured on frame 0 alone. The published code goes through inverse and forward kinematics with
    swing-only rotations, which turns each target bone exactly into the source bone's direction.
    """
    body, tree = pose_layout(layout), bone_tree(layout)
    leg = list(body.leg_joints)
    joints = joint_positions.transpose(2, 1, 0).astype(np.float32, order="C")
    bones = joints[:, 1:] - joints.take(tree.start, axis=1)
    x, y, z = bones
    length = x * x
    length += y * y
    length += z * z
    np.sqrt(length, out=length)
    source_leg = length[[joint - 1 for joint in leg], 0].sum()
    if not length.all():
        length[length == 0] = 1.0
    bones *= np.divide(target[1:, None].astype(np.float32), length, out=length)
    joints[:, 0] *= target[leg].sum() / source_leg
    for below, above in tree.runs:
        np.add(joints[:, above], bones[:, below.start - 1 : below.stop - 1], out=joints[:, below])
    return joints.transpose(2, 1, 0)


def on_floor(joint_positions: Float[np.ndarray, "frames joints 3"]) -> Float[np.ndarray, "frames joints 3"]:
    """The clip moved vertically so that the lowest joint of all frames is at height 0."""
    floor = np.array([0, joint_positions[..., 1].min(), 0], dtype=joint_positions.dtype)
    return np.asarray(joint_positions - floor)


def at_origin(joint_positions: Float[np.ndarray, "frames joints 3"]) -> Float[np.ndarray, "frames joints 3"]:
    """The clip moved horizontally so that frame 0's root is above the origin."""
    below = joint_positions[0, 0] * np.array([1, 0, 1], dtype=joint_positions.dtype)
    return np.asarray(joint_positions - below)


def facing_forward(
    joint_positions: Float[np.ndarray, "frames joints 3"], layout: str
) -> Float[np.ndarray, "frames joints 3"]:
    """The clip turned about the Y axis so that frame 0 faces Z+."""
    body: PoseLayout = pose_layout(layout)
    x, z = facing_direction(joint_positions[0], body.facing)
    length = np.hypot(x, z)
    # A body that faces nowhere, straight up or down, stays as it is.
    cosine, sine = (z / length, x / length) if length > 0 else (1.0, 0.0)
    x, z = joint_positions[..., 0], joint_positions[..., 2]
    turned = np.empty_like(joint_positions)
    np.subtract(cosine * x, sine * z, out=turned[..., 0])
    turned[..., 1] = joint_positions[..., 1]
    np.add(sine * x, cosine * z, out=turned[..., 2])
    return turned


def process(
    joint_positions: Float[np.ndarray, "frames joints 3"],
    layout: str,
    target: Float[np.ndarray, "joints"] | None = None,
) -> Float32[np.ndarray, "frames joints 3"]:
    """Raw joints → processed joints, ready for `humanml3d.vectors`; `target` defaults to `standard_bone_lengths`."""
    lengths = standard_bone_lengths(layout) if target is None else target
    return placed(uniform_skeleton(joint_positions, layout, lengths), layout)


def placed(
    joint_positions: Float[np.ndarray, "frames joints 3"], layout: str
) -> Float32[np.ndarray, "frames joints 3"]:
    """All steps but the first, for joints that have the data set's bones: on the floor, at the origin, facing Z+."""
    return facing_forward(at_origin(on_floor(joint_positions.astype(np.float32, copy=False))), layout)
