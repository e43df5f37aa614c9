"""Pose vectors in torch: batches of windows, their scaling, joints as a differentiable function, and in checkpoints."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from motionkit.core.shapes import Float, Float32, Float64, Int64
from motionkit.data.windows import PoseBatch, WindowPoses, chunks
from motionkit.features.convention import PoseVectors, PoseVectorsName
from motionkit.features.field import FIELD_VECTORS
from motionkit.features.native import NativeVectors
from motionkit.features.rotations import RotationVectors, smpl_rig

ROOT_PATH = (0, 2)
SMALLEST_SCALE = 1e-3
RIG = "rig.offsets"


@dataclass(frozen=True, eq=False)
class PoseTensors:
    """`motionkit.data.windows.PoseBatch` as tensors."""

    window: Int64[Tensor, "batch"]
    coordinates: Float64[Tensor, "batch poses"]
    fps: Float64[Tensor, "batch"]
    vectors: Float32[Tensor, "batch poses features"]

    @classmethod
    def of(cls, batch: PoseBatch) -> "PoseTensors":
        """The tensors of a batch, without copying."""
        arrays = (batch.window, batch.coordinates, batch.fps, batch.vectors)
        return cls(*(torch.from_numpy(array) for array in arrays))

    def to(self, device: torch.device) -> "PoseTensors":
        """Move to a device."""
        return PoseTensors(*(each.to(device) for each in (self.window, self.coordinates, self.fps, self.vectors)))


@dataclass(frozen=True, eq=False)
class VectorScaling:
    """Elementwise (vector − mean) / scale; `scale` in the vectors' own units."""

    mean: Float32[Tensor, "features"]
    scale: Float32[Tensor, "features"]

    def apply(self, vectors: Float[Tensor, "*poses features"]) -> Float[Tensor, "*poses features"]:
        """Standardise vectors."""
        return (vectors - self.mean) / self.scale

    def invert(self, standardised: Float[Tensor, "*poses features"]) -> Float[Tensor, "*poses features"]:
        """The inverse of `apply`."""
        return standardised * self.scale + self.mean

    def to(self, device: torch.device) -> "VectorScaling":
        """Move to a device."""
        return VectorScaling(self.mean.to(device), self.scale.to(device))


def measure_scaling(
    poses: WindowPoses,
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
    vectors = poses.frames.vectors
    size = vectors.num_features
    count, total, squares = 0, torch.zeros(size, dtype=torch.float64), torch.zeros(size, dtype=torch.float64)
    for rows in chunks(len(poses.windows), 512):
        some = torch.from_numpy(poses.evenly(rows, poses_per_window).vectors).double().flatten(0, 1)
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


def vector_tensors(vectors: PoseVectors) -> dict[str, Tensor]:
    """Tensors that a convention adds to a checkpoint: the rig of `rotations`, else none."""
    return {RIG: torch.from_numpy(vectors.skeleton.offsets)} if isinstance(vectors, RotationVectors) else {}


def vectors_of(name: PoseVectorsName, tensors: Mapping[str, Tensor]) -> PoseVectors:
    """The convention of a checkpoint; raises `KeyError` if the rig is missing."""
    if name == "rotations":
        return RotationVectors(smpl_rig(tensors[RIG].numpy()))
    return FIELD_VECTORS if name == "field" else NativeVectors()
