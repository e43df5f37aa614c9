"""The interface of pose vector conventions: `field`, `native` and `rotations`.

A convention is a frozen value with a size, the conversion of a store's frames to vectors (`open`: what does not depend
on the batch is computed once, the rest when poses are drawn) and of vectors to poses (`decode`).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch

from motionkit.core.shapes import Float, Float32, Float64
from motionkit.core.skeleton import Skeleton
from motionkit.data.pose_vectors import PoseVectorsName
from motionkit.data.pose_vectors.field import FIELD_VECTORS
from motionkit.data.pose_vectors.native import NativeVectors
from motionkit.data.pose_vectors.rotations import RotationVectors, smpl_rig, training_rig
from motionkit.data.poses import FrameVectors, WindowPoses
from motionkit.data.windows import chunks
from motionkit.fields.motion_field import Poses
from motionkit.store.cache import PositionCache
from motionkit.store.reader import Store


@runtime_checkable
class PoseVectors(Protocol):
    """A convention of pose vectors for a skeleton."""

    @property
    def skeleton(self) -> Skeleton:
        """The skeleton of decoded poses; its first 22 joints are the 22-joint layout's."""
        ...

    @property
    def num_features(self) -> int:
        """Numbers per pose."""
        ...

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Groups of numbers that may share a scale; each number is in one group, the path in the first."""
        ...

    def open(self, store: Store, where: str | None) -> tuple[PositionCache, FrameVectors]:
        """The sequences that match `where` and support these vectors, and the conversion of their frames.

        Raises `UsageError` if there are none.
        """
        ...

    def instants(self, seconds: Float64[np.ndarray, "times"]) -> Float64[np.ndarray, "instants"]:
        """The ascending instants at which decoding needs vectors: `seconds`, or more than those."""
        ...

    def decode(
        self,
        vectors: Float32[np.ndarray, "instants numbers"],
        instants: Float64[np.ndarray, "instants"],
        seconds: Float64[np.ndarray, "times"],
    ) -> Poses:
        """Poses at `seconds` in the window's frame, from vectors at `instants(seconds)`."""
        ...


ROOT_PATH = (0, 2)
SMALLEST_SCALE = 1e-3


@dataclass(frozen=True, eq=False)
class VectorScaling:
    """Elementwise (vector − mean) / scale; `scale` in the vectors' own units."""

    mean: Float32[torch.Tensor, "numbers"]
    scale: Float32[torch.Tensor, "numbers"]

    def apply(self, vectors: Float[torch.Tensor, "*poses numbers"]) -> Float[torch.Tensor, "*poses numbers"]:
        """Standardise vectors."""
        return (vectors - self.mean) / self.scale

    def invert(self, standardised: Float[torch.Tensor, "*poses numbers"]) -> Float[torch.Tensor, "*poses numbers"]:
        """The inverse of `apply`."""
        return standardised * self.scale + self.mean

    def to(self, device: torch.device) -> "VectorScaling":
        """Move to a device."""
        return VectorScaling(self.mean.to(device), self.scale.to(device))


def measure_scaling(
    poses: WindowPoses,
    vectors: PoseVectors = FIELD_VECTORS,
    *,
    grouped: bool,
    root_weight: float = 1.0,
    centred_path: bool = False,
    poses_per_window: int = 32,
) -> VectorScaling:
    """Mean and scale of the windows' vectors, from poses spread evenly over each window; one pass, constant memory.

    Each number has its own scale; with `grouped`, each of the convention's groups has one (`field` vectors: the root's
    x and z, and everything else), so that errors are weighted as in millimetres. `root_weight` then multiplies the
    first group, the root's path. With `centred_path` x and z of positions have mean zero, so that standardised poses
    can be rotated.
    """
    size = vectors.num_features
    count, total, squares = 0, torch.zeros(size, dtype=torch.float64), torch.zeros(size, dtype=torch.float64)
    for rows in chunks(len(poses.windows), 512):
        some = poses.evenly(rows, poses_per_window).vectors.double().flatten(0, 1)
        count += len(some)
        total, squares = total + some.sum(0), squares + some.square().sum(0)
    mean = total / count
    if centred_path:
        mean.view(-1, 3)[:, [0, 2]] = 0.0
    variance = squares / count - mean.square()
    groups = [list(group) for group in vectors.groups]
    if grouped:
        for group in groups:
            variance[group] = variance[group].mean()
    scale = variance.clamp(min=SMALLEST_SCALE**2).sqrt()
    scale[groups[0]] /= root_weight
    return VectorScaling(mean.float(), scale.float())


RIG = "rig.offsets"


def training_vectors(name: PoseVectorsName, store: Store, where: str | None) -> PoseVectors:
    """The convention for training on these sequences of a store; raises `UsageError` as `open` does."""
    if name == "field":
        return FIELD_VECTORS
    return NativeVectors() if name == "native" else RotationVectors(training_rig(store, where))


def described(vectors: PoseVectors) -> dict[str, torch.Tensor]:
    """Tensors that a convention adds to a checkpoint: the rig of `rotations`, else none."""
    return {RIG: torch.from_numpy(vectors.skeleton.offsets)} if isinstance(vectors, RotationVectors) else {}


def restored(name: PoseVectorsName, tensors: Mapping[str, torch.Tensor]) -> PoseVectors:
    """The convention of a checkpoint; raises `KeyError` if the rig is missing."""
    if name == "rotations":
        return RotationVectors(smpl_rig(tensors[RIG].numpy()))
    return FIELD_VECTORS if name == "field" else NativeVectors()
