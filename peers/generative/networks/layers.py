"""Shared layers of the generative networks: position encodings, transformers with long skips, diffusion, guidance."""

import math
from collections.abc import Callable

import torch
from torch import Tensor, nn

from motionkit.core.shapes import Bool, Float, Int64, Shaped
from motionkit.training.diffusion.process import (
    add_noise,
    cumulative_alphas,
    loss_weights,
    predicted_noise,
    prediction_target,
    sample,
    sampling_steps,
)
from motionkit.training.diffusion.settings import DiffusionConfig
from peers.generative.batches import Conditions, ConditionSizes, SampleBatch, joined_conditions
from peers.generative.settings import TransformerSizes


def sinusoids(positions: Shaped[Tensor, "n"], width: int) -> Float[Tensor, "n width"]:
    """Sinusoidal embedding, sin and cos interleaved, wavelengths from 2π to 20,000π (Vaswani et al. 2017)."""
    frequencies = torch.exp(-math.log(10_000.0) * torch.arange(0, width, 2, device=positions.device) / width)
    angles = positions[:, None].to(torch.float32) * frequencies
    return torch.stack((angles.sin(), angles.cos()), dim=-1).flatten(1)


class ConditionVector(nn.Module):
    """Embeds a text or action; zeros where no condition is given."""

    def __init__(self, sizes: ConditionSizes, width: int) -> None:
        super().__init__()
        self.width = width
        self.text = nn.Linear(sizes.text_dimension, width) if sizes.text_dimension else None
        self.actions = nn.Embedding(len(sizes.actions), width) if sizes.actions else None

    def forward(self, conditions: Conditions) -> Float[Tensor, "batch width"]:
        """Embeddings of a batch of conditions."""
        vector = torch.zeros((len(conditions.given), self.width), device=conditions.given.device)
        if self.text is not None:
            vector = vector + self.text(conditions.text)
        if self.actions is not None:
            vector = vector + self.actions(conditions.action.clamp(min=0))
        return vector * conditions.given[:, None]


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


def last_states(
    states: Float[Tensor, "batch frames width"], lengths: Int64[Tensor, "batch"]
) -> Float[Tensor, "batch width"]:
    """A recurrent layer's states at the motions' last frames."""
    return states[torch.arange(len(states), device=states.device), lengths - 1]


def first_poses(
    rows: Float[Tensor, "batch frames numbers"], mean_share: float, generator: torch.Generator
) -> Float[Tensor, "batch numbers"]:
    """The first pose of each motion, replaced by the mean pose (zeros) with probability `mean_share`."""
    kept = torch.rand((len(rows), 1), generator=generator) >= mean_share
    return rows[:, 0] * kept.to(rows.device)


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
    """Skip connections from layer i to layer n − 1 − i (concatenation and a linear layer), then a layer norm.

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


def padding_masked(hidden: Bool[Tensor, "batch tokens"] | None) -> Callable[[nn.Module, Tensor], Tensor]:
    """Calls an encoder layer with the padding mask `hidden`."""
    return lambda layer, tokens: layer(tokens, src_key_padding_mask=hidden)


NetworkOutput = Callable[[Tensor, Tensor, Conditions], Tensor]
"""(noisy [batch, …], steps [batch], conditions) → what `DiffusionConfig.prediction` names, of the same shape."""


def noised(
    clean: Float[Tensor, "batch frames numbers"], config: DiffusionConfig, generator: torch.Generator
) -> tuple[Float[Tensor, "batch frames numbers"], Int64[Tensor, "batch"], Float[Tensor, "batch frames numbers"]]:
    """Noise each motion to a random step, drawn on the CPU; gives noisy motions, steps and noise on their device."""
    steps = torch.randint(config.num_steps, (len(clean),), generator=generator).to(clean.device)
    noise = torch.randn(clean.shape, generator=generator).to(clean.device)
    alphas = cumulative_alphas(config).to(clean.device)
    noisy = add_noise(clean.flatten(1), noise.flatten(1), steps, alphas).view(clean.shape)
    return noisy, steps, noise


def diffusion_loss(
    output: NetworkOutput,
    clean: Float[Tensor, "batch frames numbers"],
    mask: Bool[Tensor, "batch frames"],
    conditions: Conditions,
    config: DiffusionConfig,
    generator: torch.Generator,
) -> Float[Tensor, ""]:
    """Squared error at random steps, averaged over each motion's valid frames, then over motions."""
    alphas = cumulative_alphas(config).to(clean.device)
    noisy, steps, noise = noised(clean, config, generator)
    target = prediction_target(config.prediction, clean.flatten(1), noise.flatten(1), steps, alphas).view(clean.shape)
    weights = loss_weights(config.prediction, config.loss, alphas)[steps].float()
    noisy = noisy * mask[..., None]
    errors = (output(noisy, steps, conditions).float() - target).square().mean(dim=-1) * mask
    return (weights * errors.sum(dim=1) / mask.sum(dim=1)).mean()


@torch.inference_mode()
def diffusion_sample(
    output: NetworkOutput,
    batch: SampleBatch,
    draw: Callable[[], Float[Tensor, "batch frames numbers"]],
    config: DiffusionConfig,
) -> Float[Tensor, "batch frames numbers"]:
    """Sample clean motions or latents, float64, on the batch's device; with guidance both passes share one batch.

    `draw` returns fresh noise on the CPU.
    """
    alphas, scale = cumulative_alphas(config), config.guidance_scale
    twice = batch.guided and scale != 1.0
    conditions = joined_conditions(batch) if twice else batch.conditions.to(batch.device)
    start = draw().to(batch.device)
    shape = start.shape

    def predict_noise(flat: Tensor, steps: Tensor) -> Tensor:
        noisy = flat.view(shape).float()
        at = steps.to(batch.device)
        if twice:
            conditional, unconditional = output(noisy.repeat(2, 1, 1), at.repeat(2), conditions).chunk(2)
            prediction = unconditional + scale * (conditional - unconditional)
        else:
            prediction = output(noisy, at, conditions)
        return predicted_noise(config.prediction, prediction.double().flatten(1), flat, float(alphas[int(steps[0])]))

    def fresh() -> Tensor:
        return draw().to(batch.device).flatten(1)

    draw_noise = fresh if config.sampler == "ddpm" else None
    drawn = sample(predict_noise, start.flatten(1), alphas, sampling_steps(config), draw_noise=draw_noise)
    return drawn.view(shape)
