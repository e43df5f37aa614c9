"""The interface of pose vector conventions that models learn: `field`, `native` and `rotations`.

A convention is a frozen value with a size, the way from what is kept of each frame of a corpus (its `values`) to
vectors in a window's frame, and the way from vectors to poses. `motionkit.data.windows` gathers values of a store.
"""

from typing import Literal, Protocol, runtime_checkable

import numpy as np

from motionkit.core.shapes import Float, Float32, Float64
from motionkit.core.skeleton import Skeleton
from motionkit.fields.motion_field import Poses, Times

PoseVectorsName = Literal["field", "native", "rotations"]

Values = Float32[np.ndarray, "windows poses *row"]
"""What is kept of each frame."""
Weight = Float32[np.ndarray, "windows poses"]
Yaw = Float[np.ndarray, "windows"]
"""Radians, of windows in the world."""
Origin = Float[np.ndarray, "windows 2"]
"""x and z in metres, of windows in the world."""
Vectors = Float32[np.ndarray, "windows poses features"]
Instants = Float64[np.ndarray, "instants"]
InstantVectors = Float32[np.ndarray, "instants features"]


@runtime_checkable
class PoseVectors(Protocol):
    """A convention of pose vectors for a skeleton. `values` are arrays with what is kept of one frame in each row."""

    @property
    def skeleton(self) -> Skeleton:
        """The skeleton of decoded poses; its first 22 joints are the 22-joint layout's."""

    @property
    def num_features(self) -> int:
        """Numbers per pose."""

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Groups of numbers that may share a scale; each number is in one group, the path in the first."""

    def mirror(self, values: Float32[np.ndarray, "*frames_and_row"]) -> Float32[np.ndarray, "*frames_and_row"]:
        """The values of the mirrored motion."""

    def between(self, before: Values, after: Values, weight: Weight) -> Values:
        """Interpolate between the values of two frames."""

    def encode(self, values: Values, yaw: Yaw, origin: Origin) -> Vectors:
        """Pose vectors in the frames of windows: yaw in radians, origin (x, z) in metres."""

    def instants(self, seconds: Times) -> Instants:
        """The ascending instants at which decoding needs vectors: `seconds`, or more than those."""

    def decode(self, vectors: InstantVectors, instants: Instants, seconds: Times) -> Poses:
        """Poses at `seconds` in the window's frame, from vectors at `instants(seconds)`."""
