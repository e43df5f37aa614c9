"""Which numbers of a latent a motion of a given duration depends on.

A local latent's knots cover l_max (`nerm.latents.knots`); those that no instant of the motion reads are noise to the
field, so the denoiser neither learns nor generates them.
"""

import torch
from jaxtyping import Bool, Float32
from torch import Tensor

from nerm.latents.local import LocalLatents

ALWAYS = -1.0


def first_read(dimension: int, banks: LocalLatents | None) -> Float32[Tensor, "latent"]:
    """The earliest instant, in units of l_max, at which the field reads each number of z; `ALWAYS` without knots."""
    if banks is None:
        return torch.full((dimension,), ALWAYS)
    numbers = banks.describe()
    return (0.5 * (1.0 + numbers.centre - numbers.reach)).to(torch.float32)


def in_use(first_read: Float32[Tensor, "latent"], duration: Float32[Tensor, "batch"]) -> Bool[Tensor, "batch latent"]:
    """Which numbers motions of some durations (in units of l_max) depend on."""
    return first_read < duration[:, None]
