"""Classifier-free guidance: the conditional and the unconditional prediction combined (Eq. 6)."""

from collections.abc import Callable

from jaxtyping import Float, Int64
from torch import Tensor

from nerm.conditions.batch import Conditions

ConditionalDenoiser = Callable[[Tensor, Tensor, Conditions], Tensor]
"""(z_k [batch, latent], k [batch], c) → the network's output [batch, latent]."""


def guided(
    denoiser: ConditionalDenoiser,
    latents: Float[Tensor, "batch latent"],
    steps: Int64[Tensor, "batch"],
    conditions: Conditions,
    guidance_scale: float,
) -> Float[Tensor, "batch latent"]:
    """r·ε(z, k, c) + (1 − r)·ε(z, k, ∅) (Eq. 6), both passes in one batch.

    At a given z_k the same combination of predicted latents, or of velocities, is the same guidance. One pass is enough
    where r is 1 or no row has a condition.
    """
    nothing_given = bool((conditions.action < 0).all()) and not bool(conditions.text.any())
    if guidance_scale == 1.0 or nothing_given:
        return denoiser(latents, steps, conditions)
    both = denoiser(latents.repeat(2, 1), steps.repeat(2), conditions.stacked_on(conditions.unconditional()))
    conditional, unconditional = both.chunk(2)
    return guidance_scale * conditional + (1 - guidance_scale) * unconditional
