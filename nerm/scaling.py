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
    else by another, so that errors weigh as they do in millimetres. `root_weight` then multiplies the path. Where
    latents hold a path of the body, x and z have mean zero, so that standardised poses can be turned.
    """
    size = 3 * poses.source.positions.shape[1]
    count, total, squares = 0, torch.zeros(size, dtype=torch.float64), torch.zeros(size, dtype=torch.float64)
    for rows in chunks(len(poses.windows), 512):
        vectors = poses.evenly(rows, poses_per_window).vectors.double().flatten(0, 1)
        count += len(vectors)
        total, squares = total + vectors.sum(0), squares + vectors.square().sum(0)
    mean = total / count
    if config.latent_layout == "local" and config.path_knots:
        mean.view(-1, 3)[:, [0, 2]] = 0.0
    variance = squares / count - mean.square()
    if config.scaling == "group":
        on_path = torch.zeros(len(variance), dtype=torch.bool)
        on_path[list(ROOT_PATH)] = True
        for group in (on_path, ~on_path):
            variance[group] = variance[group].mean()
    scale = variance.clamp(min=SMALLEST_SCALE_METRES**2).sqrt()
    scale[list(ROOT_PATH)] /= config.root_weight
    return VectorScaling(mean.float(), scale.float())
