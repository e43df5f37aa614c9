"""A store's sequences at one framerate as rotation rows: every k-th real frame, nothing interpolated."""

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Literal

import numpy as np

from motionkit.core.errors import UsageError
from motionkit.core.shapes import Float32, Float64, Int64
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.features.rotations import num_features, rotation_rows, rows_of_poses
from motionkit.fields.motion_field import Poses
from motionkit.store.cache import PositionCache, open_cache
from motionkit.store.reader import Store

Batch = Int64[np.ndarray, "batch"]
PerSequence = Int64[np.ndarray, "sequences"]


@dataclass(frozen=True, eq=False)
class RotationSequences:
    """Rows of native frames, of which every `keep_every`-th is one at `fps`.

    `source` is the index of each sequence's source. `num_frames` counts a sequence's frames at `fps`, from any of its
    first `keep_every` native ones. `skipped` counts sequences whose framerate is no integer multiple of `fps`.
    """

    fps: Fraction
    rows: Float32[np.ndarray, "total_frames numbers"]
    skeleton: Skeleton
    sequence_index: PerSequence
    source: PerSequence
    start_row: PerSequence
    num_frames: PerSequence
    keep_every: PerSequence
    skipped: int

    @property
    def num_features(self) -> int:
        """Numbers per frame: 135 for 22 joints."""
        return int(self.rows.shape[1])

    def read(
        self, sequence: Batch, first_native: Batch, stride: Batch, frames: Int64[np.ndarray, "batch frames"]
    ) -> Float32[np.ndarray, "batch frames numbers"]:
        """World rows of every `stride`-th native frame, counted by `frames` from a native frame of their sequence."""
        row = self.start_row[sequence] + first_native
        world: Float32[np.ndarray, "batch frames numbers"] = self.rows[row[:, None] + frames * stride[:, None]]
        return world

    def seconds_between(self, sequence: Batch, stride: Batch) -> Float64[np.ndarray, "batch"]:
        """Seconds from one to the next of every `stride`-th native frame."""
        return np.asarray(stride / (self.keep_every[sequence] * float(self.fps)))


def open_rotation_sequences(
    store: Store, fps: Fraction, *, where: str | None = None, layout: Literal["smpl22", "native"] = "smpl22"
) -> RotationSequences:
    """The sequences that `where` selects at `fps`; their rows are computed once and cached beside the store's cache.

    Raises `UsageError` if there are none, or for sequences of several skeletons with the layout `native`.
    """
    cache = open_cache(store, layout=layout, where=where)
    skeleton = SMPL22 if layout == SMPL22.name else _one_skeleton(store, cache)
    multiple = cache.fps_numerator * fps.denominator
    keep_every, remainder = np.divmod(multiple, cache.fps_denominator * fps.numerator)
    chosen = (remainder == 0) & (keep_every > 0)
    if not chosen.any():
        rates = sorted({f"{cache.exact_fps(sequence)}" for sequence in range(cache.num_sequences)})
        raise UsageError(
            f"no chosen sequence of {store.path} has a framerate that is a whole multiple of {fps} fps (they have "
            f"{', '.join(rates[:8])}): choose another fps, or another where"
        )
    size = num_features(skeleton.num_joints)
    rows = cache.derived_rows("rotation-rows-1", size, lambda: _vectors(store, cache, skeleton))
    keep_every = np.maximum(keep_every, 1)
    names = store.columns("source")["source"].loc[cache.sequence_index[chosen]].to_numpy(str)
    return RotationSequences(
        fps=fps,
        rows=rows,
        skeleton=skeleton,
        sequence_index=cache.sequence_index[chosen].astype(np.int64),
        source=np.unique(names, return_inverse=True)[1].astype(np.int64),
        start_row=cache.start_row[chosen],
        num_frames=np.maximum(1, cache.num_frames // keep_every)[chosen].astype(np.int64),
        keep_every=keep_every[chosen],
        skipped=int((~chosen).sum()),
    )


def _vectors(store: Store, cache: PositionCache, skeleton: Skeleton) -> Iterator[Float32[np.ndarray, "frames numbers"]]:
    for motion in store.read_many(cache.sequence_index.tolist()):
        if cache.layout == SMPL22.name:
            yield rotation_rows(motion).vectors
        else:
            yield rows_of_poses(Poses.of(motion), skeleton).vectors


def _one_skeleton(store: Store, cache: PositionCache) -> Skeleton:
    names = sorted(set(store.columns("skeleton")["skeleton"].loc[cache.sequence_index]))
    skeletons = [store.skeletons[name] for name in names]
    first = skeletons[0]
    for other in skeletons[1:]:
        if (other.joint_names, other.parents) != (first.joint_names, first.parents):
            raise UsageError(
                f"layout=native learns one skeleton's own rotations, but the chosen sequences have {first.name!r} and "
                f"{other.name!r}: choose one with where (skeleton = '{first.fingerprint}'), or use layout=smpl22"
            )
    if not first.left_right_pairs:
        raise UsageError(f"skeleton {first.name!r} has no left/right pairs, by which a window's heading is known")
    return first
