"""The diffusion process of NeRM §3.2: the noise schedule, training pairs (Eq. 5), the DDIM and DDPM samplers.

Everything the process itself computes is float64 and knows nothing of networks: a sampler is given a function that
predicts noise. Steps k count from 0 (almost clean) to num_steps − 1 (almost pure noise), as the arrays do.
"""

from collections.abc import Callable, Sequence

import torch
from jaxtyping import Float, Float64, Int64
from torch import Tensor

from nerm.denoiser_config import DiffusionConfig

NoisePredictor = Callable[[Tensor, Tensor], Tensor]
"""(z_k [batch, latent], k [batch]) → predicted noise [batch, latent]."""


def cumulative_alphas(config: DiffusionConfig) -> Float64[Tensor, "steps"]:
    """ᾱ_k = ∏ (1 − β_j) for j ≤ k, with √β linear from √beta_start to √beta_end."""
    roots = torch.linspace(config.beta_start**0.5, config.beta_end**0.5, config.num_steps, dtype=torch.float64)
    return torch.cumprod(1.0 - roots**2, dim=0)


def sampling_steps(config: DiffusionConfig) -> tuple[int, ...]:
    """The steps k visited at inference, noisiest first."""
    if config.sampling_spacing == "trailing":
        ratio = config.num_steps / config.sampling_steps
        return tuple(round(config.num_steps - i * ratio) - 1 for i in range(config.sampling_steps))
    stride = config.num_steps // config.sampling_steps
    steps = (min(i * stride + 1, config.num_steps - 1) for i in range(config.sampling_steps))
    return tuple(sorted(set(steps), reverse=True))


def add_noise(
    latents: Float[Tensor, "batch latent"],
    noise: Float[Tensor, "batch latent"],
    steps: Int64[Tensor, "batch"],
    alphas: Float64[Tensor, "steps"],
) -> Float[Tensor, "batch latent"]:
    """z_k = √ᾱ_k z + √(1 − ᾱ_k) ε: the input of ε_φ in Eq. 5."""
    kept = alphas[steps][:, None]
    return (kept.sqrt() * latents + (1 - kept).sqrt() * noise).to(latents.dtype)


def predicted_latents(
    noisy: Float[Tensor, "batch latent"], noise: Float[Tensor, "batch latent"], alpha: float
) -> Float[Tensor, "batch latent"]:
    """The clean latent that a noise prediction implies: (z_k − √(1 − ᾱ_k) ε) / √ᾱ_k."""
    clean: Tensor = (noisy - (1 - alpha) ** 0.5 * noise) / alpha**0.5
    return clean


def sample_ddim(
    predict_noise: NoisePredictor,
    start: Float64[Tensor, "batch latent"],
    alphas: Float64[Tensor, "num_steps"],
    steps: Sequence[int],
) -> Float64[Tensor, "batch latent"]:
    """Deterministic sampling (DDIM, η = 0; Song et al. 2021, Eq. 12) from z_K over decreasing steps.

    The last update goes to ᾱ = 1, so what is returned is the last prediction of the clean latent.
    """
    latents = start
    targets = [float(alphas[k]) for k in steps[1:]] + [1.0]
    for k, target in zip(steps, targets, strict=True):
        noise = predict_noise(latents, torch.full((len(latents),), k, dtype=torch.int64))
        clean = predicted_latents(latents, noise.to(torch.float64), float(alphas[k]))
        latents = target**0.5 * clean + (1 - target) ** 0.5 * noise
    return latents


def sample_ddpm(
    predict_noise: NoisePredictor,
    start: Float64[Tensor, "batch latent"],
    alphas: Float64[Tensor, "num_steps"],
    steps: Sequence[int],
    draw_noise: Callable[[], Tensor],
) -> Float64[Tensor, "batch latent"]:
    """Ancestral sampling (Ho et al. 2020, Eq. 7) from z_K over decreasing steps.

    `draw_noise` returns fresh N(0, I) numbers of the shape of `start`; the last update adds none. The variance is that
    of the true posterior q(z_{k−1} | z_k, z_0), for steps that are skipped too.
    """
    latents = start
    targets = [float(alphas[k]) for k in steps[1:]] + [1.0]
    for k, target in zip(steps, targets, strict=True):
        alpha = float(alphas[k])
        noise = predict_noise(latents, torch.full((len(latents),), k, dtype=torch.int64))
        clean = predicted_latents(latents, noise.to(torch.float64), alpha)
        kept = alpha / target
        latents = (target**0.5 * (1 - kept) * clean + kept**0.5 * (1 - target) * latents) / (1 - alpha)
        if target < 1.0:
            latents = latents + ((1 - target) / (1 - alpha) * (1 - kept)) ** 0.5 * draw_noise()
    return latents
