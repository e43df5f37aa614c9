"""The diffusion process (NeRM §3.2): the noise schedule, training pairs (Eq. 5), the DDIM and DDPM samplers.

All computations are float64 and independent of networks: a sampler takes a function that predicts noise. Steps k count
from 0 (almost clean) to num_steps − 1 (almost pure noise).
"""

import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from motionkit.core.shapes import Float, Float64, Int64
from motionkit.training.diffusion.settings import DiffusionConfig, LossMeasure, Prediction

NoisePredictor = Callable[[Tensor, Tensor], Tensor]
"""(z_k [batch, latent], k [batch]) → predicted noise [batch, latent]."""

Adjust = Callable[[Tensor, int, float], Tensor]
"""(predicted clean z [batch, latent], index of the visited step, its ᾱ) → the clean z to continue with."""

LARGEST_COSINE_BETA = 0.999
MIN_SNR_GAMMA = 5.0


def cumulative_alphas(config: DiffusionConfig) -> Float64[Tensor, "steps"]:
    """ᾱ_k = ∏ (1 − β_j) for j ≤ k.

    √β is linear from √beta_start to √beta_end, or ᾱ follows cos²(π/2 · (k/K + s) / (1 + s)) with s = 0.008 and β ≤
    0.999 (Nichol & Dhariwal 2021, Eq. 17).
    """
    if config.schedule == "scaled_linear":
        roots = torch.linspace(config.beta_start**0.5, config.beta_end**0.5, config.num_steps, dtype=torch.float64)
        return torch.cumprod(1.0 - roots**2, dim=0)
    times = torch.arange(config.num_steps + 1, dtype=torch.float64) / config.num_steps
    curve = torch.cos((times + 0.008) / 1.008 * (math.pi / 2)).square()
    betas = (1.0 - curve[1:] / curve[:-1]).clamp(max=LARGEST_COSINE_BETA)
    return torch.cumprod(1.0 - betas, dim=0)


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
    """The clean latent from a noise prediction: (z_k − √(1 − ᾱ_k) ε) / √ᾱ_k."""
    clean: Tensor = (noisy - (1 - alpha) ** 0.5 * noise) / alpha**0.5
    return clean


def prediction_target(
    prediction: Prediction,
    latents: Float[Tensor, "batch latent"],
    noise: Float[Tensor, "batch latent"],
    steps: Int64[Tensor, "batch"],
    alphas: Float64[Tensor, "steps"],
) -> Float[Tensor, "batch latent"]:
    """The target of the network at z_k: ε, z or √ᾱ_k ε − √(1 − ᾱ_k) z."""
    if prediction == "noise":
        return noise
    if prediction == "latent":
        return latents
    kept = alphas[steps][:, None]
    return (kept.sqrt() * noise - (1 - kept).sqrt() * latents).to(latents.dtype)


def predicted_noise(
    prediction: Prediction, output: Float[Tensor, "batch latent"], noisy: Float[Tensor, "batch latent"], alpha: float
) -> Float[Tensor, "batch latent"]:
    """The noise from a network's output; the inverse of `prediction_target` at a known z_k."""
    if prediction == "noise":
        return output
    if prediction == "latent":
        noise: Tensor = (noisy - alpha**0.5 * output) / (1 - alpha) ** 0.5
        return noise
    from_velocity: Tensor = alpha**0.5 * output + (1 - alpha) ** 0.5 * noisy
    return from_velocity


def loss_weights(
    prediction: Prediction, measure: LossMeasure, alphas: Float64[Tensor, "steps"]
) -> Float64[Tensor, "steps"]:
    """Weights per step that convert squared errors of the network's output to those of `measure`.

    At a given z_k the errors of noise, latent and velocity are proportional: e_ε² = SNR · e_z², e_v² = (SNR + 1) · e_z²
    with SNR = ᾱ / (1 − ᾱ).
    """
    ratio = alphas / (1 - alphas)
    per_latent_error = {
        "noise": ratio,
        "latent": torch.ones_like(ratio),
        "velocity": ratio + 1,
        "min_snr": ratio.clamp(max=MIN_SNR_GAMMA),
    }
    weights: Tensor = per_latent_error[measure] / per_latent_error[prediction]
    return weights


def sample(
    predict_noise: NoisePredictor,
    start: Float64[Tensor, "batch latent"],
    alphas: Float64[Tensor, "num_steps"],
    steps: Sequence[int],
    *,
    draw_noise: Callable[[], Tensor] | None = None,
    adjust: Adjust | None = None,
) -> Float64[Tensor, "batch latent"]:
    """Sample from z_K over decreasing steps; the last update goes to ᾱ = 1, to the last prediction of the clean latent.

    Without `draw_noise` deterministically (DDIM, η = 0; Song et al. 2021, Eq. 12). With it, ancestrally (DDPM; Ho et
    al. 2020, Eq. 7): it returns fresh N(0, I) numbers of the shape of `start`, the last update adds none, and the
    variance is that of the true posterior q(z_{k−1} | z_k, z_0), for steps that are skipped too. `adjust` may change
    each prediction of the clean latent.
    """
    latents = start
    targets = [float(alphas[k]) for k in steps[1:]] + [1.0]
    for index, (k, target) in enumerate(zip(steps, targets, strict=True)):
        alpha = float(alphas[k])
        noise = predict_noise(latents, torch.full((len(latents),), k, dtype=torch.int64))
        clean = predicted_latents(latents, noise.to(torch.float64), alpha)
        if adjust is not None:
            clean = adjust(clean, index, alpha)
            noise = predicted_noise("latent", clean, latents, alpha)
        if draw_noise is None:
            latents = target**0.5 * clean + (1 - target) ** 0.5 * noise
            continue
        kept = alpha / target
        latents = (target**0.5 * (1 - kept) * clean + kept**0.5 * (1 - target) * latents) / (1 - alpha)
        if target < 1.0:
            latents = latents + ((1 - target) / (1 - alpha) * (1 - kept)) ** 0.5 * draw_noise()
    return latents
