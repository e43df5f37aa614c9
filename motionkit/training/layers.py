"""What generative networks share: sampled latents and their divergence, long skip connections."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn

from motionkit.core.shapes import Float


def reparameterized(
    mean: Float[Tensor, "batch *numbers"], log_variance: Float[Tensor, "batch *numbers"], generator: torch.Generator
) -> Float[Tensor, "batch *numbers"]:
    """Sample z ~ N(μ, σ²) by the reparameterisation trick, with noise from a CPU generator."""
    noise = torch.randn(mean.shape, generator=generator).to(mean.device)
    return mean + (0.5 * log_variance).exp() * noise


def kl_divergence(
    mean: Float[Tensor, "*numbers"], log_variance: Float[Tensor, "*numbers"]
) -> Float[Tensor, "*numbers"]:
    """Elementwise KL divergence of N(μ, σ²) from N(0, 1), in float32 even under autocast."""
    mean, log_variance = mean.float(), log_variance.float()
    return 0.5 * (mean.square() + log_variance.exp() - 1 - log_variance)


def through_long_skips(
    tokens: Float[Tensor, "batch tokens width"],
    layers: Sequence[nn.Module] | nn.ModuleList,
    joins: Sequence[nn.Module] | nn.ModuleList,
    call: Callable[[nn.Module, Tensor], Tensor],
) -> Float[Tensor, "batch tokens width"]:
    """The tokens after an odd number n of layers; layer n − 1 − i also sees what layer i gave (U-ViT, Bao et al. 2023).

    Each of the (n − 1) / 2 `joins` is a linear map of both, concatenated. `call` applies a layer to tokens.
    """
    half, kept = len(joins), []
    for layer in layers[:half]:
        tokens = call(layer, tokens)
        kept.append(tokens)
    tokens = call(layers[half], tokens)
    for join, layer in zip(joins, layers[half + 1 :], strict=True):
        tokens = call(layer, join(torch.cat((tokens, kept.pop()), dim=-1)))
    return tokens
