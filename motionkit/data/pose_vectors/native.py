"""`native` pose vectors: the published 263 numbers in per-second units, whose path is integrated
(`motionkit.features.native`).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from motionkit.core.shapes import Bool, Float32, Float64, Int64
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.data.poses import FrameVectors
from motionkit.features import field, native
from motionkit.features.layout import SMPL22_LAYOUT
from motionkit.fields.motion_field import Poses
from motionkit.store.cache import PositionCache, RowFile, open_cache
from motionkit.store.reader import Store

SECONDS_BETWEEN_STEPS = 1 / 120
NATIVE_ROWS = "native-vectors-1"


@dataclass(frozen=True, eq=False)
class NativeRows:
    """Rows of `native` vectors; they mean the same in every window's frame."""

    rows: RowFile

    def gather(
        self, row: Int64[np.ndarray, "batch poses"], mirrored: Bool[np.ndarray, "batch"]
    ) -> Float32[np.ndarray, "batch poses numbers"]:
        """Vectors of frames, mirrored where the window is."""
        gathered = self.rows[row]
        if mirrored.any():
            gathered[mirrored] = native.mirrored(gathered[mirrored], SMPL22.name)
        return gathered

    def between(
        self,
        before: Float32[np.ndarray, "batch poses numbers"],
        after: Float32[np.ndarray, "batch poses numbers"],
        weight: Float32[np.ndarray, "batch poses"],
    ) -> Float32[np.ndarray, "batch poses numbers"]:
        """Linear, number by number."""
        return np.asarray(before + weight[..., None] * (after - before))

    def encode(
        self,
        gathered: Float32[np.ndarray, "batch poses numbers"],
        yaw: Float32[np.ndarray, "batch"],
        origin: Float32[np.ndarray, "batch 2"],
    ) -> Float32[np.ndarray, "batch poses numbers"]:
        """Unchanged: they are vectors already."""
        return gathered


@dataclass(frozen=True)
class NativeVectors:
    """The published vector's 263 numbers in per-second units, at any framerate."""

    @property
    def skeleton(self) -> Skeleton:
        """The 22-joint layout."""
        return SMPL22

    @property
    def num_features(self) -> int:
        """263."""
        return SMPL22_LAYOUT.vector.size

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """The root's three velocities, then the other blocks inside which HumanML3D averages its deviations."""
        turning, walking, *others = (tuple(range(block.start, block.stop)) for block in SMPL22_LAYOUT.vector.blocks)
        return turning + walking, *others

    def open(self, store: Store, where: str | None) -> tuple[PositionCache, FrameVectors]:
        """Vectors of whole sequences, computed once: derivatives and the smoothed facing need a frame's neighbours."""
        cache = open_cache(store, layout=SMPL22.name, where=where)

        def compute() -> Iterator[Float32[np.ndarray, "frames numbers"]]:
            for sequence in range(cache.num_sequences):
                positions = np.asarray(cache.sequence_positions(sequence))
                if len(positions) < 2:
                    yield np.zeros((len(positions), self.num_features), np.float32)
                else:
                    yield native.vectors(positions, SMPL22.name, cache.exact_fps(sequence))

        return cache, NativeRows(cache.derived_rows(NATIVE_ROWS, self.num_features, compute))

    def instants(self, seconds: Float64[np.ndarray, "times"]) -> Float64[np.ndarray, "instants"]:
        """All from the window's start, no more than 1/120 s apart: the path is integrated over them."""
        end = float(seconds.max(initial=0.0))
        return np.union1d(np.arange(0.0, end, SECONDS_BETWEEN_STEPS), seconds)

    def decode(
        self,
        vectors: Float32[np.ndarray, "instants numbers"],
        instants: Float64[np.ndarray, "instants"],
        seconds: Float64[np.ndarray, "times"],
    ) -> Poses:
        """Heading and path integrated over the time stamps; then into the frame in which the first pose faces Z+."""
        made = native.positions_at(vectors, SMPL22.name, instants)
        yaw, origin = field.window_frame(made[:1])
        return Poses(field.to_window(made[None], yaw, origin)[0, np.searchsorted(instants, seconds)])
