"""What a motion field learns at each instant: the interface of `field`, `native` and `rotations` pose vectors.

A convention is one frozen value that knows its size, how a store's frames become vectors (`open`: what doesn't depend
on the batch is computed once, the rest when poses are drawn) and how vectors at some instants become poses again
(`decode`).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Float32, Float64

from motionkit.clips.pose_vectors import PoseVectorsName
from motionkit.clips.pose_vectors.field import FIELD_VECTORS
from motionkit.clips.pose_vectors.native import NativeVectors
from motionkit.clips.pose_vectors.rotations import RotationVectors, smpl_rig, training_rig
from motionkit.clips.poses import FrameVectors, WindowPoses
from motionkit.clips.windows import chunks
from motionkit.core.skeleton import Skeleton
from motionkit.fields.motion_field import Poses
from motionkit.store.cache.positions import PositionCache
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


ROOT_PATH = (0, 2)
SMALLEST_SCALE = 1e-3


@dataclass(frozen=True, eq=False)
class VectorScaling:
    """(vector − mean) / scale, number by number; `scale` in the vectors' own units."""

    mean: Float32[torch.Tensor, "numbers"]
    scale: Float32[torch.Tensor, "numbers"]

    def apply(self, vectors: Float[torch.Tensor, "*poses numbers"]) -> Float[torch.Tensor, "*poses numbers"]:
        """Own units → standardised."""
        return (vectors - self.mean) / self.scale

    def invert(self, standardised: Float[torch.Tensor, "*poses numbers"]) -> Float[torch.Tensor, "*poses numbers"]:
        """Standardised → own units."""
        return standardised * self.scale + self.mean

    def to(self, device: torch.device) -> "VectorScaling":
        """On another device."""
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
    """Mean and scale of the windows' vectors, from poses spread evenly over each window; one pass, flat memory.

    Each number is standardised by itself, or `grouped`: each of the convention's groups has one scale (of `field`
    vectors the root's x and z one, everything else another), so that errors weigh as they do in millimetres.
    `root_weight` then multiplies the first group, the root's path. With `centred_path` x and z of positions have mean
    zero, so that standardised poses can be turned.
    """
    size = vectors.num_numbers
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
    """The convention that a training on some sequences of a store learns; raises `UsageError` as `open` does."""
    if name == "field":
        return FIELD_VECTORS
    return NativeVectors() if name == "native" else RotationVectors(training_rig(store, where))


def described(vectors: PoseVectors) -> dict[str, torch.Tensor]:
    """What a convention adds to a trained field's file: the rig of `rotations`, nothing else."""
    return {RIG: torch.from_numpy(vectors.skeleton.offsets)} if isinstance(vectors, RotationVectors) else {}


def restored(name: PoseVectorsName, tensors: Mapping[str, torch.Tensor]) -> PoseVectors:
    """A trained field's convention from its file; raises `KeyError` where the rig is missing."""
    if name == "rotations":
        return RotationVectors(smpl_rig(tensors[RIG].numpy()))
    return FIELD_VECTORS if name == "field" else NativeVectors()
