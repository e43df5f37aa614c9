"""`humanml3d` pose vectors: the published convention and processing, quirks included, for interchange.

T poses give T − 1 rows of 12·J − 1 numbers (263 for 22 joints at 20 fps, 251 for 21 joints at 12.5 fps); velocities are
per frame, so the numbers are valid only at that framerate. Two quirks are kept because every published file
has them: facing swaps the hips (HumanML3D issues #107, #119, #131), and the first frame's heading is the identity.
Smoothing (σ = 20 frames) looks 80 frames ahead, so rows of the last 80 frames depend on where the clip was cut.
Source: HumanML3D, motion_representation.ipynb and common/skeleton.py.
"""

from functools import cache

import numpy as np

from motionkit.core.shapes import Float, Float32, Float64
from motionkit.features.layout import (
    BoneTree,
    PoseLayout,
    bone_tree,
    facing_direction,
    pose_layout,
    rotations_6d,
    smooth,
    to_z_half_angle,
)
from motionkit.features.native import fill_joint_velocities, fill_positions, turn
from motionkit.io.humanml3d import recover_positions

CONVENTION = "humanml3d"
SMOOTHING_FRAMES = 20.0
# A block's arrays fit into a core's cache; rows of 2ⁿ bytes would compete for the same cache sets.
_FRAMES_AT_ONCE = 200


def vectors(joint_positions: Float[np.ndarray, "frames joints 3"], layout: str) -> Float32[np.ndarray, "rows numbers"]:
    """Pose vectors of processed joint positions, T − 1 rows for T poses.

    `joint_positions` in the file's unit and at its framerate, already on the floor, at the origin and facing Z+
    (`humanml3d_processing.process`); `layout` is `smpl22` or `kit21`. Raises `ValueError` for another number of joints
    or fewer than two poses.
    """
    body = pose_layout(layout)
    num_frames, num_joints = joint_positions.shape[:2]
    if num_joints != body.num_joints or num_frames < 2:
        raise ValueError(
            f"{layout} vectors need at least 2 poses of {body.num_joints} joints, not {num_frames} of {num_joints}"
        )
    positions = joint_positions.astype(np.float32, copy=False)
    half_angle = _half_angles(positions, body)
    tree = bone_tree(layout)
    result = np.empty((num_frames - 1, body.vector.size), dtype=np.float32)
    for start in range(0, num_frames - 1, _FRAMES_AT_ONCE):
        stop = min(start + _FRAMES_AT_ONCE, num_frames - 1)
        joints = positions[start : stop + 1].transpose(2, 1, 0).copy()
        result[start:stop] = _block(joints, half_angle[start : stop + 1], body, tree).T
    return result


def positions(vectors: Float[np.ndarray, "rows numbers"], layout: str) -> Float32[np.ndarray, "rows joints 3"]:
    """Joint positions from pose vectors, one per row: frame 0 is at the origin and faces Z+.

    Rates and displacements are summed, so rounding errors accumulate along the clip. Raises `ValueError` for vectors
    whose length differs from the layout's.
    """
    body = pose_layout(layout)
    if vectors.shape[1] != body.vector.size:
        raise ValueError(f"{layout} vectors have {body.vector.size} numbers, these have {vectors.shape[1]}")
    return recover_positions(vectors, body.num_joints)


def _half_angles(positions: Float32[np.ndarray, "frames joints 3"], body: PoseLayout) -> Float64[np.ndarray, "frames"]:
    """Half the angle about Y from each smoothed facing to Z+; the hips are swapped, frame 0 has 0."""
    facing = body.facing
    across = positions[:, facing.left_hip] - positions[:, facing.right_hip]
    across += positions[:, facing.right_shoulder] - positions[:, facing.left_shoulder]
    x, y, z = across.T
    length = np.sqrt(x * x + y * y + z * z)
    length[length == 0] = 1.0
    half_angle = to_z_half_angle(smooth(np.stack((z / length, -x / length), axis=-1), SMOOTHING_FRAMES))
    half_angle[0] = 0.0
    return half_angle


def _block(
    joints: Float32[np.ndarray, "3 joints poses"],
    half_angle: Float64[np.ndarray, "poses"],
    body: PoseLayout,
    tree: BoneTree,
) -> Float32[np.ndarray, "numbers rows"]:
    """The rows of consecutive poses; the last pose is used only for displacements."""
    slices = body.vector
    result = np.empty((slices.size, joints.shape[2] - 1), dtype=np.float32)
    poses, change = joints[:, :, :-1], joints[:, :, 1:] - joints[:, :, :-1]
    angle = 2 * half_angle
    cosine, sine = np.cos(angle).astype(np.float32), np.sin(angle).astype(np.float32)
    # The published rate comes from quaternions: a heading beyond ±π is folded back by the arcsine.
    result[slices.root_yaw_velocity] = np.arcsin(np.sin(half_angle[1:] - half_angle[:-1]))
    turn(change[:, 0], cosine[1:], sine[1:], out=result[slices.root_velocity])
    cosine, sine = cosine[:-1], sine[:-1]
    fill_positions(result, poses, cosine, sine, slices)
    rotations = result[slices.joint_rotations].reshape(body.num_joints - 1, 6, -1)
    rotations_6d(poses, half_angle[:-1].astype(np.float32), tree, out=rotations)
    fill_joint_velocities(result, change, cosine, sine, slices)
    x, y, z = change.take(body.contact_joints, axis=1)
    result[slices.contacts] = x * x + y * y + z * z < body.contact_threshold
    return result


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

    The source's leg is measured on frame 0 only. The published code uses inverse and forward kinematics with
    swing-only rotations, which gives each target bone exactly the source bone's direction.
    """
    body, tree = pose_layout(layout), bone_tree(layout)
    leg = list(body.leg_joints)
    joints = joint_positions.transpose(2, 1, 0).astype(np.float32, order="C")
    bones = joints[:, 1:] - joints.take(tree.start, axis=1)
    length = np.sqrt(np.square(bones).sum(axis=0))
    source_leg = length[[joint - 1 for joint in leg], 0].sum()
    length[length == 0] = 1.0
    bones *= target[1:, None].astype(np.float32) / length
    joints[:, 0] *= target[leg].sum() / source_leg
    for joint, start in enumerate(tree.start, start=1):
        joints[:, joint] = joints[:, start] + bones[:, joint - 1]
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
    """The clip rotated about the Y axis so that frame 0 faces Z+."""
    body: PoseLayout = pose_layout(layout)
    x, z = facing_direction(joint_positions[0], body.facing)
    length = np.hypot(x, z)
    # A body without a heading, facing straight up or down, is not rotated.
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
    """All steps but the first, for joints with the data set's bone lengths: on the floor, at the origin, facing Z+."""
    return facing_forward(at_origin(on_floor(joint_positions.astype(np.float32, copy=False))), layout)
