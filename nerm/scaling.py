"""Scales between `field` vectors in metres and what the network learns."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Float32

from motionkit.clips import WindowPoses, chunks
from nerm.recipes import FieldConfig

ROOT_PATH = (0, 2)
SMALLEST_SCALE_METRES = 1e-3


@dataclass(frozen=True, eq=False)
class VectorScaling:
    """(vector − mean) / scale, number by number; `scale` in metres."""

    mean: Float32[torch.Tensor, "numbers"]
    scale: Float32[torch.Tensor, "numbers"]

    def apply(self, vectors: Float[torch.Tensor, "*poses numbers"]) -> Float[torch.Tensor, "*poses numbers"]:
        """Metres → standardised."""
        return (vectors - self.mean) / self.scale

    def invert(self, standardised: Float[torch.Tensor, "*poses numbers"]) -> Float[torch.Tensor, "*poses numbers"]:
        """Standardised → metres."""
        return standardised * self.scale + self.mean

    def to(self, device: torch.device) -> "VectorScaling":
        """On another device."""
        return VectorScaling(self.mean.to(device), self.scale.to(device))


def measure_scaling(poses: WindowPoses, config: FieldConfig, poses_per_window: int = 32) -> VectorScaling:
    """Mean and scale of the windows' vectors, from poses spread evenly over each window; one pass, flat memory.

    `number` standardises each number by itself; `group` divides the root's path (x and z) by one scale and everything
    else by another, so that errors weigh as they do in millimetres. `root_weight` then multiplies the path.
    """
    size = 3 * poses.source.positions.shape[1]
    count, total, squares = 0, torch.zeros(size, dtype=torch.float64), torch.zeros(size, dtype=torch.float64)
    for rows in chunks(len(poses.windows), 512):
        vectors = poses.evenly(rows, poses_per_window).vectors.double().flatten(0, 1)
        count += len(vectors)
        total, squares = total + vectors.sum(0), squares + vectors.square().sum(0)
    mean = total / count
    variance = squares / count - mean.square()
    if config.scaling == "group":
        on_path = torch.zeros(len(variance), dtype=torch.bool)
        on_path[list(ROOT_PATH)] = True
        for group in (on_path, ~on_path):
            variance[group] = variance[group].mean()
    scale = variance.clamp(min=SMALLEST_SCALE_METRES**2).sqrt()
    scale[list(ROOT_PATH)] /= config.root_weight
    return VectorScaling(mean.float(), scale.float())


@dataclass(frozen=True, eq=False)
class PoseComponents:
    """Principal components of standardised poses, scaled to unit variance."""

    directions: Float32[torch.Tensor, "numbers components"]

    def scores(self, standardised: Float[torch.Tensor, "*poses numbers"]) -> Float[torch.Tensor, "*poses components"]:
        """Standardised vectors → component scores of unit variance."""
        return standardised @ self.directions

    def inverse(self) -> Float32[torch.Tensor, "components numbers"]:
        """What brings scores back to standardised vectors, as well as so few components can."""
        matrix: torch.Tensor = torch.linalg.pinv(self.directions)
        return matrix


def principal_components(poses: WindowPoses, scaling: VectorScaling, num_components: int) -> PoseComponents:
    """The first components of the windows' poses; one pass, flat memory."""
    size = len(scaling.mean)
    count, outer = 0, torch.zeros(size, size, dtype=torch.float64)
    for rows in chunks(len(poses.windows), 512):
        vectors = scaling.apply(poses.evenly(rows, 32).vectors).double().flatten(0, 1)
        count += len(vectors)
        outer = outer + vectors.T @ vectors
    values, axes = torch.linalg.eigh(outer / count)
    largest = torch.argsort(values, descending=True)[:num_components]
    directions = axes[:, largest] / values[largest].clamp(min=1e-12).sqrt()
    return PoseComponents(directions.float())
