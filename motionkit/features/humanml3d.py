"""`humanml3d` pose vectors: the published convention and processing, quirks included, for interchange.

T poses give T − 1 rows of 12·J − 1 numbers (263 for 22 joints at 20 fps, 251 for 21 joints at 12.5 fps); velocities are
per frame, so the numbers are valid only at that framerate. Two quirks are kept because every published file
has them: facing swaps the hips (HumanML3D issues #107, #119, #131), and the first frame's heading is the identity.
Smoothing (σ = 20 frames) looks 80 frames ahead, so rows of the last 80 frames depend on where the clip was cut.
Source: HumanML3D, motion_representation.ipynb and common/skeleton.py.
"""

from functools import cache

import numpy as np

from motionkit.core import kinematics
from motionkit.core.shapes import Float, Float32
from motionkit.features.layout import (
    across,
    bone_rotations,
    facing_direction,
    half_angles_to_z,
    layout_of_poses,
    pose_layout,
    pose_rows,
    relative_to_root,
)
from motionkit.io.humanml3d import recover_positions

CONVENTION = "humanml3d"
SMOOTHING_FRAMES = 20.0


def vectors(joint_positions: Float[np.ndarray, "frames joints 3"], layout: str) -> Float32[np.ndarray, "rows numbers"]:
    """Pose vectors of processed joint positions, T − 1 rows for T poses.

    `joint_positions` in the file's unit and at its framerate, already on the floor, at the origin and facing Z+
    (`process`); `layout` is `smpl22` or `kit21`. Raises `ValueError` for another number of joints
    or fewer than two poses.
    """
    body = layout_of_poses(joint_positions, layout)
    positions = joint_positions.astype(np.float32, copy=False)
    hips, shoulders = across(positions, body)
    half_angle = half_angles_to_z(shoulders - hips, SMOOTHING_FRAMES)  # the published code swaps the hips
    half_angle[0] = 0.0
    angle, poses, change = 2 * half_angle, positions[:-1], np.diff(positions, axis=0)
    return pose_rows(
        # The published rate comes from quaternions: a heading beyond ±π is folded back by the arcsine.
        np.arcsin(np.sin(np.diff(half_angle))),
        kinematics.rotate_about_y(change[:, 0], angle[1:]),
        relative_to_root(poses, angle[:-1]),
        bone_rotations(poses, half_angle[:-1], body),
        kinematics.rotate_about_y(change, angle[:-1, None]),
        np.square(change[:, list(body.contact_joints)]).sum(axis=-1) < body.contact_threshold,
    )


def positions(vectors: Float[np.ndarray, "rows numbers"], layout: str) -> Float32[np.ndarray, "rows joints 3"]:
    """Joint positions from pose vectors, one per row: frame 0 is at the origin and faces Z+.

    Rates and displacements are summed, so rounding errors accumulate along the clip. Raises `ValueError` for vectors
    whose length differs from the layout's.
    """
    body = pose_layout(layout)
    if vectors.shape[1] != body.vector.size:
        raise ValueError(f"{layout} vectors have {body.vector.size} numbers, these have {vectors.shape[1]}")
    return recover_positions(vectors, body.num_joints)


def bone_lengths(pose: Float[np.ndarray, "joints 3"], layout: str) -> Float32[np.ndarray, "joints"]:
    """Length of the bone that ends in each joint of one pose; 0 for the root."""
    lengths = np.zeros(len(pose), dtype=np.float32)
    lengths[1:] = np.linalg.norm(pose[1:] - pose[list(pose_layout(layout).skeleton.parents[1:])], axis=-1)
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

    The source's leg is measured on frame 0 only. The published code uses inverse and forward kinematics with
    swing-only rotations, which gives each target bone exactly the source bone's direction.
    """
    body, joints = pose_layout(layout), joint_positions.astype(np.float32)
    leg, parents = list(body.leg_joints), body.skeleton.parents[1:]
    bones = joints[:, 1:] - joints[:, list(parents)]
    length = np.linalg.norm(bones, axis=-1, keepdims=True)
    bones *= target[1:, None].astype(np.float32) / np.where(length > 0, length, 1.0)
    joints[:, 0] *= target[leg].sum() / sum(length[0, joint - 1, 0] for joint in leg)
    for joint, parent in enumerate(parents, start=1):
        joints[:, joint] = joints[:, parent] + bones[:, joint - 1]
    return joints


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
    """The clip rotated about the Y axis so that frame 0 faces Z+."""
    # A body without a heading, facing straight up or down, is not rotated.
    x, z = facing_direction(joint_positions[:1].astype(np.float64), pose_layout(layout)).T
    return kinematics.rotate_about_y(joint_positions, -np.arctan2(x, z))


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
    """All steps but the first, for joints with the data set's bone lengths: on the floor, at the origin, facing Z+."""
    return facing_forward(at_origin(on_floor(joint_positions.astype(np.float32, copy=False))), layout)
