"""How frames of a corpus become pose vectors: `field` vectors of positions, or what a `FrameVectors` makes of them."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float32, Int64

from motionkit.clips.windows import PositionSource, read_positions
from motionkit.core.mirror import mirror_positions
from motionkit.features import field


@runtime_checkable
class FrameVectors(Protocol):
    """How frames of a source become pose vectors: gathered by row, interpolated between rows, put into a window.

    What is gathered may be any array with a row per frame; rows are those of the source's positions.
    """

    def gather(
        self, row: Int64[np.ndarray, "batch poses"], mirrored: Bool[np.ndarray, "batch"]
    ) -> Float32[np.ndarray, "batch poses *shape"]:
        """The numbers of frames, mirrored where the window is; the caller may write to them."""
        ...

    def between(
        self,
        before: Float32[np.ndarray, "batch poses *shape"],
        after: Float32[np.ndarray, "batch poses *shape"],
        weight: Float32[np.ndarray, "batch poses"],
    ) -> Float32[np.ndarray, "batch poses *shape"]:
        """Numbers between two frames."""
        ...

    def encode(
        self,
        gathered: Float32[np.ndarray, "batch poses *shape"],
        yaw: Float32[np.ndarray, "batch"],
        origin: Float32[np.ndarray, "batch 2"],
    ) -> Float32[np.ndarray, "batch poses numbers"]:
        """Pose vectors in the windows' frames."""
        ...


@dataclass(frozen=True, eq=False)
class FramePositions:
    """`field` vectors, from positions as the source has them."""

    source: PositionSource
    left_right_pairs: tuple[tuple[int, int], ...]

    def gather(
        self, row: Int64[np.ndarray, "batch poses"], mirrored: Bool[np.ndarray, "batch"]
    ) -> Float32[np.ndarray, "batch poses joints 3"]:
        """World positions, mirrored where the window is."""
        gathered = read_positions(self.source, row)
        if mirrored.any():
            gathered[mirrored] = mirror_positions(gathered[mirrored], self.left_right_pairs)
        return gathered

    def between(
        self,
        before: Float32[np.ndarray, "batch poses joints 3"],
        after: Float32[np.ndarray, "batch poses joints 3"],
        weight: Float32[np.ndarray, "batch poses"],
    ) -> Float32[np.ndarray, "batch poses joints 3"]:
        """On straight lines."""
        return np.asarray(before + weight[..., None, None] * (after - before))

    def encode(
        self,
        gathered: Float32[np.ndarray, "batch poses joints 3"],
        yaw: Float32[np.ndarray, "batch"],
        origin: Float32[np.ndarray, "batch 2"],
    ) -> Float32[np.ndarray, "batch poses numbers"]:
        """Root path in the window's frame, joints relative to the root."""
        return field.encode(gathered, yaw, origin)
