"""Poses as rotations: the root's position, then the first two columns of every local rotation (Zhou et al. 2019).

3 + 6·J numbers per pose, 135 for 22 joints, for models whose bones must keep their lengths. The observed bones are
kept beside them, so that the inverse restores the positions exactly. All numbers are in the world frame, or in a
window's: `turned` converts from one to the other.
"""

from dataclasses import dataclass

import numpy as np

from motionkit.core import kinematics
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float, Float32, Float64
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.skeletons.mapping import map_joints
from motionkit.fields.joints import Joints
from motionkit.fields.motion_field import Poses

# Signs of the first and second column of a mirrored rotation M·R·M with M = diag(−1, 1, 1).
_FLIPPED_COLUMNS = np.array([1, -1, -1, -1, 1, 1], np.float32)


@dataclass(frozen=True, eq=False)
class PoseRows:
    """Poses as `vectors` (root position in metres, two columns per joint) and `bones` in their parent's frame, metres.

    `skeleton` gives the hierarchy; rotations are relative to its rest pose.
    """

    vectors: Float32[np.ndarray, "frames numbers"]
    bones: Float32[np.ndarray, "frames joints 3"]
    skeleton: Skeleton

    def poses(self) -> Poses:
        """The poses, with rotations."""
        return poses_of(self.vectors, self.bones, self.skeleton)


def num_features(num_joints: int) -> int:
    """Numbers per pose: 3 + 6·J, so 135 for 22 joints."""
    return 3 + 6 * num_joints


def rotation_rows(motion: Motion) -> PoseRows:
    """Any motion in the 22-joint layout.

    True local rotations are kept if the motion's own joints are the layout's; otherwise positions are mapped and
    rotations come from `inverse_kinematics_in_time`. Raises `SkeletonMapError` if a joint has no source.
    """
    if motion.skeleton.joint_names == SMPL22.joint_names:
        return rows_of_poses(Poses.of(motion), motion.skeleton)
    return rows_of_poses(Poses(map_joints(motion, SMPL22.name)), SMPL22)


def rows_of_poses(poses: Poses, skeleton: Skeleton) -> PoseRows:
    """Poses of any skeleton, in order of time, as rows.

    Poses without rotations get those of inverse kinematics; in the 22-joint layout from that layout's own rest pose, so
    that rows of all sources are comparable.
    """
    if poses.local_rotations is None and skeleton.joint_names == SMPL22.joint_names:
        skeleton = SMPL22
    joints = Joints.of(poses, skeleton)
    vectors = np.concatenate((joints.root, two_columns(joints.rotations)), axis=1)
    return PoseRows(vectors.astype(np.float32), joints.bones.astype(np.float32), skeleton)


def poses_of(
    vectors: Float[np.ndarray, "frames numbers"], bones: Float[np.ndarray, "*frames joints 3"], skeleton: Skeleton
) -> Poses:
    """The poses of vectors: the closest rotations to the columns, then forward kinematics on the bones."""
    matrices = kinematics.closest_rotations(vectors[:, 3:].astype(np.float64))
    root = vectors[:, :3].astype(np.float64)
    positions, _ = kinematics.forward_kinematics_matrices(matrices, root, skeleton, bones.astype(np.float64))
    rotations = kinematics.matrix_to_quaternion(matrices)
    return Poses(positions.astype(np.float32), rotations.astype(np.float32))


def two_columns(quaternions: Float[np.ndarray, "*poses joints 4"]) -> Float[np.ndarray, "*poses numbers"]:
    """The first two columns of each rotation matrix, joint after joint: (R₁₁, R₂₁, R₃₁, R₁₂, R₂₂, R₃₂)."""
    columns = kinematics.quaternion_to_matrix(quaternions)[..., :2].swapaxes(-1, -2)
    return np.ascontiguousarray(columns).reshape(*quaternions.shape[:-2], 6 * quaternions.shape[-2])


def turned(
    vectors: Float[np.ndarray, "windows poses numbers"],
    yaw: Float[np.ndarray, "windows"],
    origin: Float[np.ndarray, "windows 2"],
) -> Float32[np.ndarray, "windows poses numbers"]:
    """World → window: subtract the origin (x, z in metres), then rotate the root by −yaw about +Y."""
    result = vectors.astype(np.float32)
    result[..., 0] -= origin[:, None, 0]
    result[..., 2] -= origin[:, None, 1]
    _turn(result, -yaw)
    return result


def turned_back(
    vectors: Float[np.ndarray, "windows poses numbers"],
    yaw: Float[np.ndarray, "windows"],
    origin: Float[np.ndarray, "windows 2"],
) -> Float32[np.ndarray, "windows poses numbers"]:
    """Window → world: the inverse of `turned`."""
    result = vectors.astype(np.float32)
    _turn(result, yaw)
    result[..., 0] += origin[:, None, 0]
    result[..., 2] += origin[:, None, 1]
    return result


def heading(vectors: Float[np.ndarray, "*poses numbers"], skeleton: Skeleton = SMPL22) -> Float64[np.ndarray, "*poses"]:
    """Yaw in radians of each pelvis' facing direction: 0 is Z+, positive turns towards X+.

    Forward is perpendicular to the line through the skeleton's hips (its first left/right pair), and to the vertical.
    """
    left, right = skeleton.left_right_pairs[0]
    across = skeleton.offsets[left].astype(np.float64) - skeleton.offsets[right]
    matrix = kinematics.closest_rotations(vectors[..., 3:9])[..., 0, :, :]
    x, _, z = np.moveaxis(matrix @ (across / np.linalg.norm(across)), -1, 0)
    return np.asarray(np.arctan2(-z, x))


def mirrored(
    vectors: Float[np.ndarray, "*poses numbers"], skeleton: Skeleton = SMPL22
) -> Float32[np.ndarray, "*poses numbers"]:
    """The mirrored poses: x negated, left and right joints exchanged."""
    partners = np.arange(skeleton.num_joints)
    for left, right in skeleton.left_right_pairs:
        partners[left], partners[right] = right, left
    result = vectors.astype(np.float32)
    columns = result[..., 3:].reshape(*result.shape[:-1], skeleton.num_joints, 6)
    result[..., 3:] = (columns[..., partners, :] * _FLIPPED_COLUMNS).reshape(result[..., 3:].shape)
    result[..., 0] *= -1
    return result


def _turn(vectors: Float32[np.ndarray, "windows poses numbers"], yaw: Float[np.ndarray, "windows"]) -> None:
    # The root's position and the two columns of its rotation, in place.
    sine, cosine = np.sin(yaw)[:, None, None], np.cos(yaw)[:, None, None]
    three = vectors[..., :9].reshape(*vectors.shape[:-1], 3, 3)
    x, z = three[..., 0].copy(), three[..., 2].copy()
    three[..., 0] = cosine * x + sine * z
    three[..., 2] = cosine * z - sine * x
    vectors[..., :9] = three.reshape(*vectors.shape[:-1], 9)
