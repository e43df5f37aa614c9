"""Posterior latents without an encoder: one N(μ, Σ) per window, μ and log Σ free parameters (paper §3.1, B.2).

Only the rows of a batch are gathered and updated, with their Adam moments, so a step's cost does not depend on the
number of windows.
"""

import torch
from torch import Tensor

from motionkit.core.shapes import Bool, Float, Float32, Int64
from nerm.latents.local import LocalLatents

LOG_VARIANCE_RANGE = (-12.0, 4.0)


class RowAdam:
    """Sparse AdamW (Loshchilov & Hutter 2019) over rows of a table; each row counts its own steps.

    A row updated n times has had exactly n steps of dense AdamW; other rows are unchanged, without weight decay.
    """

    def __init__(
        self,
        table: Float32[torch.Tensor, "rows width"],
        betas: tuple[float, float] = (0.9, 0.999),
        epsilon: float = 1e-8,
        weight_decay: float = 0.0,
    ) -> None:
        self.table = table
        self.weight_decay = weight_decay
        self.betas = betas
        self.epsilon = epsilon
        self.first = torch.zeros_like(table)
        self.second = torch.zeros_like(table)
        self.count = torch.zeros(len(table), 1, device=table.device)

    @torch.no_grad()
    def update(
        self, rows: Int64[torch.Tensor, "chosen"], gradient: Float32[torch.Tensor, "chosen width"], rate: float
    ) -> None:
        """One step on distinct rows."""
        beta1, beta2 = self.betas
        count = self.count[rows] + 1.0
        first = torch.lerp(self.first[rows], gradient, 1.0 - beta1)
        second = torch.lerp(self.second[rows], gradient.square(), 1.0 - beta2)
        step = rate * (first / (1.0 - beta1**count)) / ((second / (1.0 - beta2**count)).sqrt() + self.epsilon)
        self.table[rows] = (1.0 - rate * self.weight_decay) * self.table[rows] - step
        self.first[rows], self.second[rows], self.count[rows] = first, second, count

    def tensors(self) -> dict[str, torch.Tensor]:
        """Table and moments."""
        return {"table": self.table, "first": self.first, "second": self.second, "count": self.count}


def sample_posterior(
    mean: Float[torch.Tensor, "batch latent"],
    log_variance: Float[torch.Tensor, "batch latent"],
    noise: Float[torch.Tensor, "batch latent"],
) -> Float[torch.Tensor, "batch latent"]:
    """z = μ + σ·ε, the reparameterisation of N(μ, Σ) (Eq. 1)."""
    return mean + torch.exp(0.5 * log_variance) * noise


def kl_divergence(
    mean: Float[torch.Tensor, "batch latent"],
    log_variance: Float[torch.Tensor, "batch latent"],
    num_windows: int | None = None,
) -> Float[torch.Tensor, ""]:
    """KL(N(μ, Σ) ‖ N(0, I)) of Eq. 3 for diagonal Σ, averaged over latent numbers and windows, in nats.

    With `num_windows` the mean is over that many windows, of which these are a part.
    """
    divergence = 0.5 * (mean.square() + log_variance.exp() - 1.0 - log_variance)
    return divergence.sum() / (mean.shape[1] * (num_windows or len(mean)))


ALWAYS = -1.0


def first_read(dimension: int, banks: LocalLatents | None) -> Float32[Tensor, "latent"]:
    """The earliest instant, in units of l_max, at which the field reads each number of z; `ALWAYS` without knots."""
    if banks is None:
        return torch.full((dimension,), ALWAYS)
    numbers = banks.describe()
    return (0.5 * (1.0 + numbers.centre - numbers.reach)).to(torch.float32)


def in_use(first_read: Float32[Tensor, "latent"], duration: Float32[Tensor, "batch"]) -> Bool[Tensor, "batch latent"]:
    """Mask of the numbers that motions of these durations (in units of l_max) use."""
    return first_read < duration[:, None]
