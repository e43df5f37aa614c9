"""What generative networks share: positions, torch's layers by their sizes, transformers with long skips, guidance."""

import math
from collections.abc import Callable

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from motionkit.training.diffusion.process import (
    add_noise,
    cumulative_alphas,
    loss_weights,
    predicted_noise,
    prediction_target,
    sample_ddim,
    sample_ddpm,
    sampling_steps,
)
from motionkit.training.diffusion.settings import DiffusionConfig
from peers.generative.batches import Conditions, Wanted, joined_conditions
from peers.generative.settings import TransformerSizes


def sinusoids(positions: Int[Tensor, "n"], width: int) -> Float[Tensor, "n width"]:
    """sin and cos in turn of positions, wavelengths from 2π to 20,000π (Vaswani et al. 2017)."""
    frequencies = torch.exp(-math.log(10_000.0) * torch.arange(0, width, 2, device=positions.device) / width)
    angles = positions[:, None].to(torch.float32) * frequencies
    return torch.stack((angles.sin(), angles.cos()), dim=-1).flatten(1)


def encoder_layer(sizes: TransformerSizes) -> nn.TransformerEncoderLayer:
    """A layer of self-attention, post-norm, GELU."""
    return nn.TransformerEncoderLayer(
        sizes.width, sizes.heads, sizes.inner, sizes.dropout, activation="gelu", batch_first=True
    )


def decoder_layer(sizes: TransformerSizes) -> nn.TransformerDecoderLayer:
    """A layer of self-attention and cross-attention, post-norm, GELU."""
    return nn.TransformerDecoderLayer(
        sizes.width, sizes.heads, sizes.inner, sizes.dropout, activation="gelu", batch_first=True
    )


class LongSkips(nn.Module):
    """Layers of which i of the first half feeds n − 1 − i, joined by concatenation and a linear map; then a norm.

    MLD's skip transformers (mld/models/operator/cross_attention.py). `attend` calls a layer.
    """

    def __init__(self, sizes: TransformerSizes, make: Callable[[TransformerSizes], nn.Module]) -> None:
        super().__init__()
        if sizes.layers % 2 == 0:
            raise ValueError(f"long skips need an odd number of layers, not {sizes.layers}")
        self.layers = nn.ModuleList(make(sizes) for _ in range(sizes.layers))
        self.joins = nn.ModuleList(nn.Linear(2 * sizes.width, sizes.width) for _ in range(sizes.layers // 2))
        self.norm = nn.LayerNorm(sizes.width)

    def forward(
        self, tokens: Float[Tensor, "batch tokens width"], attend: Callable[[nn.Module, Tensor], Tensor]
    ) -> Float[Tensor, "batch tokens width"]:
        """The tokens after all layers."""
        half, kept = len(self.joins), []
        for layer in self.layers[:half]:
            tokens = attend(layer, tokens)
            kept.append(tokens)
        tokens = attend(self.layers[half], tokens)
        for join, layer in zip(self.joins, self.layers[half + 1 :], strict=True):
            tokens = attend(layer, join(torch.cat((tokens, kept.pop()), dim=-1)))
        normed: Tensor = self.norm(tokens)
        return normed


def among(hidden: Bool[Tensor, "batch tokens"] | None) -> Callable[[nn.Module, Tensor], Tensor]:
    """Calls an encoder layer whose tokens don't attend to those that are `hidden`."""
    return lambda layer, tokens: layer(tokens, src_key_padding_mask=hidden)


NetworkOutput = Callable[[Tensor, Tensor, Conditions], Tensor]
"""(noisy [batch, …], steps [batch], conditions) → what `DiffusionConfig.prediction` names, of the same shape."""


def diffusion_loss(
    output: NetworkOutput,
    clean: Float[Tensor, "batch frames numbers"],
    seen: Bool[Tensor, "batch frames"],
    conditions: Conditions,
    config: DiffusionConfig,
    generator: torch.Generator,
) -> Float[Tensor, ""]:
    """Squared error at random steps: for each motion the mean over what is seen of it, then the mean over motions."""
    device, count = clean.device, len(clean)
    alphas = cumulative_alphas(config)
    steps = torch.randint(config.num_steps, (count,), generator=generator)
    noise = torch.randn(clean.shape, generator=generator)
    flat = clean.to("cpu").flatten(1)
    noisy = add_noise(flat, noise.flatten(1), steps, alphas).view(clean.shape).to(device)
    target = prediction_target(config.prediction, flat, noise.flatten(1), steps, alphas).view(clean.shape).to(device)
    weights = loss_weights(config.prediction, config.loss, alphas)[steps].to(device, torch.float32)
    noisy = noisy * seen[..., None]
    errors = (output(noisy, steps.to(device), conditions).float() - target).square().mean(dim=-1) * seen
    return (weights * errors.sum(dim=1) / seen.sum(dim=1)).mean()


@torch.inference_mode()
def diffusion_sample(
    output: NetworkOutput,
    wanted: Wanted,
    draw: Callable[[], Float[Tensor, "batch frames numbers"]],
    config: DiffusionConfig,
) -> Float[Tensor, "batch frames numbers"]:
    """Clean motions or latents of noise, with guidance both passes in one batch; `draw` gives fresh noise."""
    alphas, scale = cumulative_alphas(config), config.guidance_scale
    twice = wanted.guided and scale != 1.0
    conditions = joined_conditions(wanted) if twice else wanted.conditions.to(wanted.device)
    start = draw()
    shape = start.shape

    def predict_noise(flat: Tensor, steps: Tensor) -> Tensor:
        noisy = flat.view(shape).to(wanted.device, torch.float32)
        at = steps.to(wanted.device)
        if twice:
            with_it, without = output(noisy.repeat(2, 1, 1), at.repeat(2), conditions).chunk(2)
            made = without + scale * (with_it - without)
        else:
            made = output(noisy, at, conditions)
        told = made.to("cpu", torch.float64).flatten(1)
        return predicted_noise(config.prediction, told, flat, float(alphas[int(steps[0])]))

    visited = sampling_steps(config)
    if config.sampler == "ddim":
        return sample_ddim(predict_noise, start.flatten(1), alphas, visited).view(shape)
    return sample_ddpm(predict_noise, start.flatten(1), alphas, visited, lambda: draw().flatten(1)).view(shape)
