"""`rotations` pose vectors: SMPL's parameters, for the action task (paper, appendix A; ACTOR and MLD learn the same).

Per pose 3 + 6·J numbers: the root's position in the window's frame (metres, as `field` vectors have it), then for each
joint the first two columns of its local rotation matrix (Zhou et al. 2019), the root's in the window's frame. Poses
come back by forward kinematics on one skeleton, the mean of the training bodies, so that they have true rotations and
one shape; J is 24 where every body has SMPL's two hand joints, else the 22 that all SMPL bodies share.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import UsageError
from motionkit.core.mirror import FLIP, TURN_BACK
from motionkit.core.shapes import Bool, Float, Float32, Float64, Int64
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.data.poses import FrameVectors
from motionkit.features import field
from motionkit.features.rotation_rows import num_features, two_columns
from motionkit.fields.motion_field import Poses
from motionkit.store.cache import PositionCache, RowFile, open_cache
from motionkit.store.reader import Store
from motionkit.store.sql import conjunction

NAMES = (*SMPL22.joint_names, "left_hand", "right_hand")
PARENTS = (*SMPL22.parents, SMPL22.index("left_wrist"), SMPL22.index("right_wrist"))
PAIRS = (*SMPL22.left_right_pairs, (22, 23))
MOST_DEGREES_APART = 45.0
# A leg, the spine and an arm: bones long enough to compare rest poses by their directions.
TELLING_JOINTS = tuple(map(SMPL22.index, ("left_knee", "neck", "left_elbow", "right_elbow")))


@dataclass(frozen=True, eq=False)
class RotationRows:
    """Rows of root position (3) and local quaternions (4·J, w x y z) of every frame; `partners` are mirrored joints."""

    rows: RowFile
    partners: tuple[int, ...]

    def gather(
        self, row: Int64[np.ndarray, "batch poses"], mirrored: Bool[np.ndarray, "batch"]
    ) -> Float32[np.ndarray, "batch poses kept"]:
        """Root positions and quaternions of frames, mirrored where the window is."""
        gathered = self.rows[row]
        if mirrored.any():
            some = gathered[mirrored]
            some[..., :3] *= FLIP
            turned = _quaternions(some)[..., list(self.partners), :] * TURN_BACK
            some[..., 3:] = turned.reshape(some[..., 3:].shape)
            gathered[mirrored] = some
        return gathered

    def between(
        self,
        before: Float32[np.ndarray, "batch poses kept"],
        after: Float32[np.ndarray, "batch poses kept"],
        weight: Float32[np.ndarray, "batch poses"],
    ) -> Float32[np.ndarray, "batch poses kept"]:
        """The root on a straight line, rotations on great arcs."""
        root = before[..., :3] + weight[..., None] * (after[..., :3] - before[..., :3])
        turned = kinematics.quaternion_slerp(_quaternions(before), _quaternions(after), weight[..., None])
        return np.concatenate((root, turned.reshape(before[..., 3:].shape)), axis=-1).astype(np.float32)

    def encode(
        self,
        gathered: Float32[np.ndarray, "batch poses kept"],
        yaw: Float32[np.ndarray, "batch"],
        origin: Float32[np.ndarray, "batch 2"],
    ) -> Float32[np.ndarray, "batch poses numbers"]:
        """Root position and rotation into the window's frame, quaternions into two columns."""
        root = field.to_window(gathered[..., None, :3], yaw, origin)[..., 0, :]
        turned = _quaternions(gathered).copy()
        half = -0.5 * yaw
        back = np.stack((np.cos(half), np.zeros_like(half), np.sin(half), np.zeros_like(half)), axis=-1)
        turned[..., 0, :] = kinematics.quaternion_multiply(back[:, None], turned[..., 0, :])
        return np.concatenate((root, two_columns(turned)), axis=-1).astype(np.float32)


@dataclass(frozen=True)
class RotationVectors:
    """Root position and 6D local rotations of the joints of `skeleton`."""

    skeleton: Skeleton

    @property
    def num_features(self) -> int:
        """3 + 6·J: 135 or 147."""
        return num_features(self.skeleton.num_joints)

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """The root's x and z, its height, the rotations."""
        return (0, 2), (1,), tuple(range(3, self.num_features))

    def open(self, store: Store, where: str | None) -> tuple[PositionCache, FrameVectors]:
        """Rotations of whole sequences, copied from the store into one memory map once."""
        joints = self.skeleton.num_joints
        cache = open_cache(store, layout=SMPL22.name, where=with_rotations(store, where, joints))

        def compute() -> Iterator[Float32[np.ndarray, "frames numbers"]]:
            for motion in store.read_many(cache.sequence_index.tolist()):
                assert motion.local_rotations is not None
                root = motion.joint_positions[:, 0] if motion.root_translation is None else motion.root_translation
                yield np.concatenate((root, motion.local_rotations[:, :joints].reshape(len(root), -1)), axis=1)

        partners = list(range(joints))
        for left, right in self.skeleton.left_right_pairs:
            partners[left], partners[right] = right, left
        rows = cache.derived_rows(f"rotations-{joints}-1", 3 + 4 * joints, compute)
        return cache, RotationRows(rows, tuple(partners))

    def instants(self, seconds: Float64[np.ndarray, "times"]) -> Float64[np.ndarray, "times"]:
        """`seconds` themselves: nothing is integrated."""
        return seconds

    def decode(
        self,
        vectors: Float32[np.ndarray, "times numbers"],
        instants: Float64[np.ndarray, "times"],
        seconds: Float64[np.ndarray, "times"],
    ) -> Poses:
        """The closest rotations to the two columns (Gram-Schmidt), and positions by forward kinematics."""
        rotations = kinematics.matrix_to_quaternion(kinematics.closest_rotations(vectors[:, 3:])).astype(np.float32)
        root = np.ascontiguousarray(vectors[:, :3], dtype=np.float32)
        return Poses(kinematics.forward_kinematics(rotations, root, self.skeleton), rotations, root)


def with_rotations(store: Store, where: str | None, num_joints: int = SMPL22.num_joints) -> str:
    """The condition for sequences with rotations of SMPL's first joints among those for which `where` holds.

    Raises `UsageError` where there are none.
    """
    known = [name for name, skeleton in store.skeletons.items() if _is_smpl(skeleton, num_joints)]
    listed = ", ".join(f"'{fingerprint}'" for fingerprint in sorted(known)) or "''"
    condition = conjunction(where, f"has_rotations AND skeleton IN ({listed})")
    if not len(store.select(condition)):
        among = f" among those with {where}" if where else ""
        raise UsageError(
            f"pose_vectors=rotations needs sequences with the joint rotations of SMPL's {num_joints} joints "
            f"(AMASS, UESTC); {store.path} has none{among}: ingest some, or train on positions "
            "(pose_vectors=field)"
        )
    return condition


def training_rig(store: Store, where: str | None) -> Skeleton:
    """The skeleton that poses are decoded on: the mean of the chosen sequences' bodies, with hands where all have them.

    Raises `UsageError` where there are none, or where rest poses differ: the same rotations then mean other poses.
    """
    chosen = store.select(with_rotations(store, where))
    bodies = [store.skeletons[name] for name in sorted(set(store.columns("skeleton")["skeleton"].loc[chosen]))]
    num_joints = len(NAMES) if all(_is_smpl(body, len(NAMES)) for body in bodies) else SMPL22.num_joints
    offsets = np.stack([body.offsets[:num_joints] for body in bodies])
    _check_rest_poses(bodies, offsets)
    return smpl_rig(offsets.mean(axis=0))


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


def _is_smpl(skeleton: Skeleton, num_joints: int) -> bool:
    return (skeleton.joint_names[:num_joints], skeleton.parents[:num_joints]) == (
        NAMES[:num_joints],
        PARENTS[:num_joints],
    )


def _check_rest_poses(skeletons: Sequence[Skeleton], offsets: Float[np.ndarray, "skeletons joints 3"]) -> None:
    bones = offsets[:, list(TELLING_JOINTS)]
    directions = bones / np.maximum(np.linalg.norm(bones, axis=-1, keepdims=True), 1e-9)
    cosine = np.sum(directions * directions[:1], axis=-1).min(axis=1)
    apart = int(np.argmin(cosine))
    if cosine[apart] < np.cos(np.radians(MOST_DEGREES_APART)):
        raise UsageError(
            f"skeletons {skeletons[0].name!r} and {skeletons[apart].name!r} rest in other poses, so their rotations do "
            f"not mean the same: train on one kind (--where \"skeleton = '{skeletons[0].fingerprint}'\")"
        )


def _quaternions(gathered: Float[np.ndarray, "*poses numbers"]) -> Float[np.ndarray, "*poses joints 4"]:
    # Explicit sizes: -1 fails if a rank's part of a batch is empty.
    return gathered[..., 3:].reshape(*gathered.shape[:-1], (gathered.shape[-1] - 3) // 4, 4)
