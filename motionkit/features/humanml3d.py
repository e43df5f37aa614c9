"""`humanml3d` pose vectors: the published convention, its quirks included, for interchange.

T poses give T − 1 rows of 12·J − 1 numbers (263 for 22 joints at 20 fps, 251 for 21 joints at 12.5 fps); velocities are
per frame, so the numbers mean what they mean at that framerate alone. Two quirks are kept because every published file
has them: facing swaps the hips (HumanML3D issues #107, #119, #131), and the first frame's heading is the identity.
Smoothing (σ = 20 frames) looks 80 frames ahead, so rows of the last 80 frames depend on where the clip was cut.
Source: HumanML3D, motion_representation.ipynb and common/skeleton.py.
"""

import numpy as np
from jaxtyping import Float, Float32, Float64

from motionkit.features.bones import BoneTree, bone_tree, rotations_6d
from motionkit.features.facing import smooth, to_z_half_angle
from motionkit.features.layout import PoseLayout, pose_layout
from motionkit.features.rows import fill_joint_velocities, fill_positions, turn
from motionkit.formats.pose_folders.humanml3d import recover_positions

CONVENTION = "humanml3d"
SMOOTHING_FRAMES = 20.0
SMOOTHING_REACH = 80
# What a block needs fits into a core's cache; rows of 2ⁿ bytes would all compete for the same few places in it.
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

    Rates and displacements are summed, so rounding adds up along the clip. Raises `ValueError` for vectors of another
    length than the layout's.
    """
    body = pose_layout(layout)
    if vectors.shape[1] != body.vector.size:
        raise ValueError(f"{layout} vectors have {body.vector.size} numbers, these have {vectors.shape[1]}")
    return recover_positions(vectors, body.num_joints)


def _half_angles(positions: Float32[np.ndarray, "frames joints 3"], body: PoseLayout) -> Float64[np.ndarray, "frames"]:
    """Half the turn about Y that brings each smoothed facing to Z+; the hips are swapped, frame 0 is not turned."""
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
    """The rows of consecutive poses, the last of which only ends the displacements."""
    part = body.vector
    result = np.empty((part.size, joints.shape[2] - 1), dtype=np.float32)
    poses, change = joints[:, :, :-1], joints[:, :, 1:] - joints[:, :, :-1]
    angle = 2 * half_angle
    cosine, sine = np.cos(angle).astype(np.float32), np.sin(angle).astype(np.float32)
    # The published rate comes from quaternions: a heading that passes ±π folds back through the arcsine.
    result[part.root_yaw_velocity] = np.arcsin(np.sin(half_angle[1:] - half_angle[:-1]))
    turn(change[:, 0], cosine[1:], sine[1:], out=result[part.root_velocity])
    cosine, sine = cosine[:-1], sine[:-1]
    fill_positions(result, poses, cosine, sine, part)
    rotations = result[part.joint_rotations].reshape(body.num_joints - 1, 6, -1)
    rotations_6d(poses, half_angle[:-1].astype(np.float32), tree, out=rotations)
    fill_joint_velocities(result, change, cosine, sine, part)
    x, y, z = change.take(body.contact_joints, axis=1)
    result[part.contacts] = x * x + y * y + z * z < body.contact_threshold
    return result
