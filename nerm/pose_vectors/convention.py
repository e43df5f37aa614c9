"""What a motion field learns at each instant: the interface of `field`, `native` and `rotations` pose vectors.

A convention is one frozen value that knows its size, how a store's frames become vectors (`open`: what doesn't depend
on the batch is computed once, the rest when poses are drawn) and how vectors at some instants become poses again
(`decode`).
"""

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32, Float64

from motionkit.clips.frame_vectors import FrameVectors
from motionkit.motionfield import Poses
from motionkit.skeleton import Skeleton
from motionkit.store.cache import PositionCache
from motionkit.store.reader import Store


@runtime_checkable
class PoseVectors(Protocol):
    """A convention of pose vectors over some skeleton."""

    @property
    def skeleton(self) -> Skeleton:
        """The skeleton of decoded poses; its first 22 joints are the 22-joint layout's."""
        ...

    @property
    def num_numbers(self) -> int:
        """Numbers per pose."""
        ...

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Numbers of one unit and kind, which may share a scale; each number is in one group, the path in the first."""
        ...

    def open(self, store: Store, where: str | None) -> tuple[PositionCache, FrameVectors]:
        """The sequences for which `where` holds and that have such vectors, and how their frames become them.

        Raises `UsageError` where there are none.
        """
        ...

    def instants(self, seconds: Float64[np.ndarray, "times"]) -> Float64[np.ndarray, "instants"]:
        """The instants at which decoding needs vectors: `seconds` themselves, or more than those in ascending order."""
        ...

    def decode(
        self,
        vectors: Float32[np.ndarray, "instants numbers"],
        instants: Float64[np.ndarray, "instants"],
        seconds: Float64[np.ndarray, "times"],
    ) -> Poses:
        """Poses at `seconds` in the window's frame, from vectors at `instants(seconds)`."""
        ...
