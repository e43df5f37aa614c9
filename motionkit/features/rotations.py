"""Poses as rotations: the root's position, then the first two columns of every local rotation (Zhou et al. 2019).

3 + 6·J numbers per pose, 135 for 22 joints, for models whose bones must keep their lengths. All numbers are in the
world frame, or in a window's: `to_window` and `to_world` convert. `PoseRows` keep the observed bones beside them, so
that the inverse restores the positions exactly. `RotationVectors` are SMPL's parameters, for the action task (NeRM's
appendix A; ACTOR and MLD learn the same): poses come back by forward kinematics on one skeleton, the mean of the
training bodies, so that they have true rotations and one shape; J is 24 where every body has SMPL's two hand joints,
else the 22 that all SMPL bodies share.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import UsageError
from motionkit.core.motion import FLIP, TURN_BACK, Motion, exchanged
from motionkit.core.shapes import Float, Float32, Float64
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.skeletons.mapping import map_joints
from motionkit.features import field
from motionkit.features.convention import Instants, InstantVectors, Origin, Values, Vectors, Weight, Yaw
from motionkit.fields.motion_field import Joints, Poses, Times

Rows = Float[np.ndarray, "windows poses numbers"]

NAMES = (*SMPL22.joint_names, "left_hand", "right_hand")
PARENTS = (*SMPL22.parents, SMPL22.index("left_wrist"), SMPL22.index("right_wrist"))
PAIRS = (*SMPL22.left_right_pairs, (22, 23))
MOST_DEGREES_APART = 45.0
# A leg, the spine and an arm: bones long enough to compare rest poses by their directions.
COMPARED_JOINTS = tuple(map(SMPL22.index, ("left_knee", "neck", "left_elbow", "right_elbow")))
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
    vectors = np.concatenate((joints.root, kinematics.two_columns(joints.rotations)), axis=1)
    return PoseRows(vectors.astype(np.float32), joints.bones.astype(np.float32), skeleton)


def poses_of(
    vectors: Float[np.ndarray, "frames numbers"], bones: Float[np.ndarray, "*frames joints 3"], skeleton: Skeleton
) -> Poses:
    """The poses of vectors: the closest rotations to the columns, then forward kinematics on the bones."""
    matrices = kinematics.closest_rotations(vectors[:, 3:].astype(np.float64))
    root = vectors[:, :3].astype(np.float64)
    positions = kinematics.forward_kinematics_matrices(matrices, root, skeleton, bones.astype(np.float64))
    rotations = kinematics.matrix_to_quaternion(matrices)
    return Poses(positions.astype(np.float32), rotations.astype(np.float32))


def to_window(vectors: Rows, yaw: Yaw, origin: Origin) -> Float32[np.ndarray, "windows poses numbers"]:
    """World → window: subtract the origin (x, z in metres), then rotate the root by −yaw about +Y."""
    result = vectors.astype(np.float32)
    result[..., [0, 2]] -= origin[:, None]
    _turn(result, -yaw)
    return result


def to_world(vectors: Rows, yaw: Yaw, origin: Origin) -> Float32[np.ndarray, "windows poses numbers"]:
    """Window → world: the inverse of `to_window`."""
    result = vectors.astype(np.float32)
    _turn(result, yaw)
    result[..., [0, 2]] += origin[:, None]
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
    partners = exchanged(skeleton.num_joints, skeleton.left_right_pairs)
    result = vectors.astype(np.float32)
    columns = result[..., 3:].reshape(*result.shape[:-1], skeleton.num_joints, 6)
    result[..., 3:] = (columns[..., partners, :] * _FLIPPED_COLUMNS).reshape(result[..., 3:].shape)
    result[..., 0] *= -1
    return result


def _turn(vectors: Float32[np.ndarray, "windows poses numbers"], yaw: Yaw) -> None:
    # The root's position and the two columns of its rotation, in place.
    three = vectors[..., :9].reshape(*vectors.shape[:-1], 3, 3)
    vectors[..., :9] = kinematics.rotate_about_y(three, yaw[:, None, None]).reshape(*vectors.shape[:-1], 9)


@dataclass(frozen=True)
class RotationVectors:
    """`rotations` as a convention to learn (`motionkit.features.convention.PoseVectors`), for the joints of `skeleton`.

    Values are the root's world position (3) and local quaternions (4·J, w x y z).
    """

    skeleton: Skeleton

    @property
    def num_features(self) -> int:
        """3 + 6·J: 135 or 147."""
        return num_features(self.skeleton.num_joints)

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """The root's x and z, its height, the rotations."""
        return (0, 2), (1,), tuple(range(3, self.num_features))

    def values(self, motion: Motion) -> Float32[np.ndarray, "frames row"]:
        """The values of a motion with rotations of SMPL's first joints."""
        assert motion.local_rotations is not None
        root = motion.joint_positions[:, 0] if motion.root_translation is None else motion.root_translation
        rotations = motion.local_rotations[:, : self.skeleton.num_joints]
        return np.concatenate((root, rotations.reshape(len(root), -1)), axis=1)

    def mirror(self, values: Float32[np.ndarray, "*frames row"]) -> Float32[np.ndarray, "*frames row"]:
        """x negated, left and right joints exchanged, rotations mirrored."""
        partners = exchanged(self.skeleton.num_joints, self.skeleton.left_right_pairs)
        rotations = _quaternions(values)[..., partners, :] * TURN_BACK
        return np.concatenate((values[..., :3] * FLIP, rotations.reshape(values[..., 3:].shape)), axis=-1)

    def between(self, before: Values, after: Values, weight: Weight) -> Values:
        """The root on a straight line, rotations on great arcs."""
        root = before[..., :3] + weight[..., None] * (after[..., :3] - before[..., :3])
        rotations = kinematics.quaternion_slerp(_quaternions(before), _quaternions(after), weight[..., None])
        return np.concatenate((root, rotations.reshape(before[..., 3:].shape)), axis=-1).astype(np.float32)

    def encode(self, values: Values, yaw: Yaw, origin: Origin) -> Vectors:
        """Root position and rotation into the window's frame, quaternions into two columns."""
        root = field.to_window(values[..., None, :3], yaw, origin)[..., 0, :]
        rotations = _quaternions(values).copy()
        half = -0.5 * yaw
        back = np.stack((np.cos(half), np.zeros_like(half), np.sin(half), np.zeros_like(half)), axis=-1)
        rotations[..., 0, :] = kinematics.quaternion_multiply(back[:, None], rotations[..., 0, :])
        return np.concatenate((root, kinematics.two_columns(rotations)), axis=-1).astype(np.float32)

    def instants(self, seconds: Times) -> Times:
        """`seconds` themselves: nothing is integrated."""
        return seconds

    def decode(self, vectors: InstantVectors, instants: Instants, seconds: Times) -> Poses:
        """The closest rotations to the two columns (Gram-Schmidt), and positions by forward kinematics."""
        rotations = kinematics.matrix_to_quaternion(kinematics.closest_rotations(vectors[:, 3:])).astype(np.float32)
        root = np.ascontiguousarray(vectors[:, :3], dtype=np.float32)
        return Poses(kinematics.forward_kinematics(rotations, root, self.skeleton), rotations, root)


def _quaternions(values: Float[np.ndarray, "*frames row"]) -> Float[np.ndarray, "*frames joints 4"]:
    # Explicit sizes: -1 fails if a rank's share of a batch is empty.
    return values[..., 3:].reshape(*values.shape[:-1], (values.shape[-1] - 3) // 4, 4)


def smpl_rig(offsets: Float32[np.ndarray, "joints 3"]) -> Skeleton:
    """The skeleton of SMPL's first 22 or 24 joints with these rest offsets in metres; the root's is the origin."""
    num_joints = len(offsets)
    bones = offsets.copy()
    bones[0] = 0.0
    return Skeleton(
        name=f"smpl{num_joints}-mean",
        joint_names=NAMES[:num_joints],
        parents=PARENTS[:num_joints],
        offsets=bones,
        left_right_pairs=PAIRS if num_joints == len(NAMES) else SMPL22.left_right_pairs,
        feet=SMPL22.feet,
    )


def begins_as_smpl(skeleton: Skeleton, num_joints: int = SMPL22.num_joints) -> bool:
    """Whether a skeleton's first joints are SMPL's."""
    return (skeleton.joint_names[:num_joints], skeleton.parents[:num_joints]) == (
        NAMES[:num_joints],
        PARENTS[:num_joints],
    )


def mean_rig(bodies: Sequence[Skeleton]) -> Skeleton:
    """The mean of SMPL bodies, with hands where all have them.

    Raises `UsageError` where rest poses differ: the same rotations then mean other poses.
    """
    num_joints = len(NAMES) if all(begins_as_smpl(body, len(NAMES)) for body in bodies) else SMPL22.num_joints
    offsets = np.stack([body.offsets[:num_joints] for body in bodies])
    bones = offsets[:, list(COMPARED_JOINTS)]
    directions = bones / np.maximum(np.linalg.norm(bones, axis=-1, keepdims=True), 1e-9)
    cosine = np.sum(directions * directions[:1], axis=-1).min(axis=1)
    apart = int(np.argmin(cosine))
    if cosine[apart] < np.cos(np.radians(MOST_DEGREES_APART)):
        raise UsageError(
            f"skeletons {bodies[0].name!r} and {bodies[apart].name!r} rest in other poses, so their rotations do "
            f"not mean the same: train on one kind (--where \"skeleton = '{bodies[0].fingerprint}'\")"
        )
    return smpl_rig(offsets.mean(axis=0))
