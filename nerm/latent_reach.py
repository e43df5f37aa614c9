"""Which numbers of a latent a motion of a given duration depends on.

A local latent's knots cover l_max (`nerm.knots`); those that no instant of the motion reads are noise to the field, so
the denoiser neither learns nor generates them.
"""

import torch
from jaxtyping import Bool, Float32
from torch import Tensor

from nerm.recipes import FieldConfig

ALWAYS = -1.0


def first_read(config: FieldConfig) -> Float32[Tensor, "latent"]:
    """The earliest instant, in units of l_max, at which the field reads each number of z; `ALWAYS` without knots."""
    if config.latent_layout == "global":
        return torch.full((config.latent_dimension,), ALWAYS)
    knots = (torch.arange(config.num_knots) - config.knot_radius) / (config.num_knots - 1)
    return knots.to(torch.float32).repeat_interleave(config.latent_dimension // config.num_knots)


def in_use(first_read: Float32[Tensor, "latent"], duration: Float32[Tensor, "batch"]) -> Bool[Tensor, "batch latent"]:
    """Which numbers motions of some durations (in units of l_max) depend on."""
    return first_read < duration[:, None]
