"""A store's sequences as a convention of pose vectors sees them: what is kept of each frame, and which sequences."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from motionkit.core.errors import UsageError
from motionkit.core.shapes import Bool, Float32, Int64
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.data.windows import PositionSource
from motionkit.features import native
from motionkit.features.convention import PoseVectors, PoseVectorsName
from motionkit.features.field import FIELD_VECTORS
from motionkit.features.native import NativeVectors
from motionkit.features.rotations import RotationVectors, begins_as_smpl, mean_rig
from motionkit.store.cache import PositionCache, open_cache
from motionkit.store.reader import Store
from motionkit.store.sql import conjunction

NATIVE_ROWS = "native-vectors-1"


@dataclass(frozen=True, eq=False)
class FrameValues:
    """What `vectors` keeps of each frame of a corpus: a row for each row of its cache's positions."""

    rows: Float32[np.ndarray, "total_frames *values"]
    vectors: PoseVectors

    @classmethod
    def of_positions(cls, source: PositionSource) -> "FrameValues":
        """The positions themselves, for `field` vectors."""
        return cls(source.positions, FIELD_VECTORS)

    def gather(
        self, row: Int64[np.ndarray, "batch poses"], mirrored: Bool[np.ndarray, "batch"]
    ) -> Float32[np.ndarray, "batch poses *row"]:
        """Copies of the values of frames, mirrored for mirrored windows."""
        values: Float32[np.ndarray, "batch poses *row"] = self.rows[row]
        if mirrored.any():
            values[mirrored] = self.vectors.mirror(values[mirrored])
        return values


def training_vectors(name: PoseVectorsName, store: Store, where: str | None) -> PoseVectors:
    """The convention for training on these sequences of a store; raises `UsageError` as `open_frames` does."""
    if name == "field":
        return FIELD_VECTORS
    return NativeVectors() if name == "native" else RotationVectors(training_rig(store, where))


def open_frames(vectors: PoseVectors, store: Store, where: str | None) -> tuple[PositionCache, FrameValues]:
    """The sequences that match `where` and support these vectors, and the values of their frames.

    Values other than positions are computed once, from whole sequences, and kept beside the cache. Raises `UsageError`
    if there are no such sequences.
    """
    if isinstance(vectors, RotationVectors):
        joints = vectors.skeleton.num_joints
        cache = open_cache(store, layout=SMPL22.name, where=with_rotations(store, where, joints))
        motions = (motion for motion in store.read_many(cache.sequence_index.tolist()))
        rows = cache.derived_rows(f"rotations-{joints}-1", 3 + 4 * joints, lambda: map(vectors.values, motions))
        return cache, FrameValues(rows, vectors)
    cache = open_cache(store, layout=SMPL22.name, where=where)
    if isinstance(vectors, NativeVectors):
        rows = cache.derived_rows(NATIVE_ROWS, vectors.num_features, lambda: _native_vectors(cache))
        return cache, FrameValues(rows, vectors)
    return cache, FrameValues(cache.positions, vectors)


def _native_vectors(cache: PositionCache) -> Iterator[Float32[np.ndarray, "frames features"]]:
    for sequence in range(cache.num_sequences):
        positions = np.asarray(cache.sequence_positions(sequence))
        if len(positions) < 2:
            yield np.zeros((len(positions), NativeVectors().num_features), np.float32)
        else:
            yield native.vectors(positions, SMPL22.name, cache.exact_fps(sequence))


def with_rotations(store: Store, where: str | None, num_joints: int = SMPL22.num_joints) -> str:
    """The condition for sequences with rotations of SMPL's first joints among those for which `where` holds.

    Raises `UsageError` where there are none.
    """
    known = [name for name, skeleton in store.skeletons.items() if begins_as_smpl(skeleton, num_joints)]
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
    """The skeleton that poses are decoded on: the mean of the chosen sequences' bodies (`mean_rig`).

    Raises `UsageError` where there are none, or where rest poses differ.
    """
    chosen = store.select(with_rotations(store, where))
    return mean_rig([store.skeletons[name] for name in sorted(set(store.columns("skeleton")["skeleton"].loc[chosen]))])
