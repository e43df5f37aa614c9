"""What the networks of generative systems share: their interface, layers, diffusion of motions and latents."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from motionkit.core.shapes import Bool, Float, Int64, Shaped
from motionkit.training.config import DiffusionConfig
from motionkit.training.networks import (
    ConditionalNetwork,
    Conditions,
    ConditionSizes,
    add_noise,
    cumulative_alphas,
    guided,
    predicted_noise,
    prediction_target,
    sample,
    sampling_steps,
    through_long_skips,
)
from peers.motions import Lengths, Mask, MotionBatch, PoseSpace, Rows, SampleBatch


@dataclass(frozen=True)
class TransformerSizes:
    """Sizes of torch's transformer layers: post-norm, GELU."""

    layers: int
    width: int
    heads: int
    inner: int
    dropout: float = 0.1


@dataclass(frozen=True, eq=False)
class NetworkInputs:
    """What a network is built for: pose space, conditions, number of training windows, networks of earlier stages."""

    space: PoseSpace
    conditions: ConditionSizes
    num_windows: int
    earlier: Mapping[str, nn.Module]


class PeerNetwork(nn.Module):
    """A network that is built from its sizes and `NetworkInputs`; that of a system's last stage can be sampled.

    `diffusion` are its diffusion settings, None if it is no diffusion model.
    """

    diffusion: DiffusionConfig | None = None

    def begin_step(self, step: int, steps: int) -> None:
        """Called before training step `step` (from 0) of `steps`."""

    def losses(self, batch: MotionBatch, generator: torch.Generator) -> dict[str, Tensor]:
        """Metrics of a batch, of which `loss` is minimised; randomness comes from `generator` (CPU)."""
        raise NotImplementedError

    def sample(self, batch: SampleBatch, diffusion: DiffusionConfig) -> Rows:
        """Standardised rows of motions; frames beyond a motion's length are undefined."""
        raise NotImplementedError


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


def last_states(states: Float[Tensor, "batch frames width"], lengths: Lengths) -> Float[Tensor, "batch width"]:
    """A recurrent layer's states at the motions' last frames."""
    return states[torch.arange(len(states), device=states.device), lengths - 1]


def first_poses(rows: Rows, mean_share: float, generator: torch.Generator) -> Float[Tensor, "batch numbers"]:
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
    """Layers with long skip connections, then a layer norm (MLD, mld/models/operator/cross_attention.py)."""

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
        """The tokens after all layers; `attend` calls a layer."""
        normed: Tensor = self.norm(through_long_skips(tokens, self.layers, self.joins, attend))
        return normed


def padding_masked(hidden: Bool[Tensor, "batch tokens"] | None) -> Callable[[nn.Module, Tensor], Tensor]:
    """Calls an encoder layer with the padding mask `hidden`."""
    return lambda layer, tokens: layer(tokens, src_key_padding_mask=hidden)


def noised(
    clean: Rows, config: DiffusionConfig, generator: torch.Generator
) -> tuple[Rows, Int64[Tensor, "batch"], Rows]:
    """Noise each motion to a random step, drawn on the CPU; gives noisy motions, steps and noise on their device."""
    steps = torch.randint(config.num_steps, (len(clean),), generator=generator).to(clean.device)
    noise = torch.randn(clean.shape, generator=generator).to(clean.device)
    alphas = cumulative_alphas(config).to(clean.device)
    noisy = add_noise(clean.flatten(1), noise.flatten(1), steps, alphas).view(clean.shape)
    return noisy, steps, noise


def diffusion_loss(
    network: ConditionalNetwork,
    clean: Rows,
    mask: Mask,
    conditions: Conditions,
    config: DiffusionConfig,
    generator: torch.Generator,
) -> Float[Tensor, ""]:
    """Squared error at random steps, averaged over each motion's valid frames, then over motions."""
    alphas = cumulative_alphas(config).to(clean.device)
    noisy, steps, noise = noised(clean, config, generator)
    target = prediction_target(config.prediction, clean.flatten(1), noise.flatten(1), steps, alphas).view(clean.shape)
    noisy = noisy * mask[..., None]
    errors = (network(noisy, steps, conditions).float() - target).square().mean(dim=-1) * mask
    return (errors.sum(dim=1) / mask.sum(dim=1)).mean()


@torch.inference_mode()
def diffusion_sample(
    network: ConditionalNetwork, batch: SampleBatch, draw: Callable[[], Rows], config: DiffusionConfig
) -> Rows:
    """Sample clean motions or latents, float64, on the batch's device; `draw` returns fresh noise on the CPU."""
    alphas, start = cumulative_alphas(config), draw().to(batch.device)
    scale = batch.conditions.guidance(config.guidance_scale)
    shape = start.shape
    conditions, unconditional = batch.conditions.to(batch.device), batch.unconditional.to(batch.device)

    def predict_noise(flat: Tensor, steps: Tensor) -> Tensor:
        noisy, at = flat.view(shape).float(), steps.to(batch.device)
        output = guided(network, noisy, at, conditions, unconditional, scale)
        return predicted_noise(config.prediction, output.double().flatten(1), flat, float(alphas[int(steps[0])]))

    def fresh() -> Tensor:
        return draw().to(batch.device).flatten(1)

    draw_noise = fresh if config.sampler == "ddpm" else None
    drawn = sample(predict_noise, start.flatten(1), alphas, sampling_steps(config), draw_noise=draw_noise)
    return drawn.view(shape)
