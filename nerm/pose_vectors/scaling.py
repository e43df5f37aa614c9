"""Scales between pose vectors in their own units and what the network learns."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Float32

from motionkit.clips.order import chunks
from motionkit.clips.poses import WindowPoses
from nerm.pose_vectors.convention import PoseVectors
from nerm.pose_vectors.field import FIELD_VECTORS
from nerm.settings.field import FieldConfig

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
    poses: WindowPoses, config: FieldConfig, vectors: PoseVectors = FIELD_VECTORS, poses_per_window: int = 32
) -> VectorScaling:
    """Mean and scale of the windows' vectors, from poses spread evenly over each window; one pass, flat memory.

    `number` standardises each number by itself; `group` gives each of the convention's groups one scale (of `field`
    vectors the root's x and z one, everything else another), so that errors weigh as they do in millimetres.
    `root_weight` then multiplies the first group, the root's path. Where latents hold a path of the body, x and z have
    mean zero, so that standardised poses can be turned.
    """
    size = vectors.num_numbers
    count, total, squares = 0, torch.zeros(size, dtype=torch.float64), torch.zeros(size, dtype=torch.float64)
    for rows in chunks(len(poses.windows), 512):
        some = poses.evenly(rows, poses_per_window).vectors.double().flatten(0, 1)
        count += len(some)
        total, squares = total + some.sum(0), squares + some.square().sum(0)
    mean = total / count
    if config.latent_layout == "local" and config.path_knots:
        mean.view(-1, 3)[:, [0, 2]] = 0.0
    variance = squares / count - mean.square()
    groups = [list(group) for group in vectors.groups]
    if config.scaling == "group":
        for group in groups:
            variance[group] = variance[group].mean()
    scale = variance.clamp(min=SMALLEST_SCALE**2).sqrt()
    scale[groups[0]] /= config.root_weight
    return VectorScaling(mean.float(), scale.float())
