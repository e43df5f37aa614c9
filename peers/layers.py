"""What the networks of generative systems share: their interface, layers, diffusion of motions and latents."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from motionkit.core.shapes import Float, Int64, Shaped
from motionkit.training import networks
from motionkit.training.config import DiffusionConfig
from motionkit.training.networks import ConditionalNetwork, Conditions, ConditionSizes, guided
from peers.motions import Lengths, Mask, MotionBatch, PoseSpace, Rows, SampleBatch

Latents = Float[Tensor, "batch width"]  # one vector of each motion
Steps = Int64[Tensor, "batch"]  # the diffusion step of each motion
Tokens = Float[Tensor, "batch tokens width"]


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
    """What a network is built for: pose space, conditions, number of training windows, network of an earlier stage."""

    space: PoseSpace
    conditions: ConditionSizes
    num_windows: int
    earlier: nn.Module | None = None


class PeerNetwork(nn.Module):
    """A network that is built from its sizes and `NetworkInputs`; that of a system's last stage can be sampled.

    `diffusion` are its diffusion settings, None if it is no diffusion model.
    """

    diffusion: DiffusionConfig | None = None

    def losses(self, batch: MotionBatch) -> dict[str, Tensor]:
        """Metrics of a batch, of which `loss` is minimised."""
        raise NotImplementedError

    def sample(self, batch: SampleBatch) -> Rows:
        """Standardised rows of motions; frames beyond a motion's length are undefined."""
        raise NotImplementedError


def sinusoids(positions: Shaped[Tensor, "n"], width: int) -> Float[Tensor, "n width"]:
    """Sinusoidal embedding, sin and cos interleaved, wavelengths from 2π to 20,000π (Vaswani et al. 2017)."""
    frequencies = torch.exp(-math.log(10_000.0) * torch.arange(0, width, 2, device=positions.device) / width)
    angles = positions[:, None].to(torch.float32) * frequencies
    return torch.stack((angles.sin(), angles.cos()), dim=-1).flatten(1)


def positions(tokens: Tokens) -> Float[Tensor, "tokens width"]:
    """The sinusoidal embedding of each token's place."""
    return sinusoids(torch.arange(tokens.shape[1], device=tokens.device), tokens.shape[2])


class ConditionVector(nn.Module):
    """Embeds a text or action; zeros where none is given, or with `null_text` the vector of the null text."""

    def __init__(self, sizes: ConditionSizes, width: int, *, null_text: bool = False) -> None:
        super().__init__()
        self.width, self.null_text = width, null_text
        self.text = nn.Linear(sizes.text_dimension, width) if sizes.text_dimension else None
        self.actions = nn.Embedding(len(sizes.actions), width) if sizes.actions else None

    def forward(self, conditions: Conditions) -> Latents:
        """Embeddings of a batch of conditions."""
        given = conditions.given[:, None]
        vector: Tensor = torch.zeros((len(given), self.width), device=given.device)
        if self.text is not None:
            vector = self.text(conditions.text)
        elif self.actions is not None:
            vector = self.actions(conditions.action.clamp(min=0))
        return vector if self.text is not None and self.null_text else vector * given


def last_states(states: Float[Tensor, "batch frames width"], lengths: Lengths) -> Latents:
    """A recurrent layer's states at the motions' last frames."""
    return states[torch.arange(len(states), device=states.device), lengths - 1]


def first_poses(rows: Rows, mean_share: float, generator: torch.Generator) -> Latents:
    """The first pose of each motion, replaced by the mean pose (zeros) with probability `mean_share`."""
    kept = torch.rand((len(rows), 1), generator=generator) >= mean_share
    return rows[:, 0] * kept.to(rows.device)


def encoder_layer(sizes: TransformerSizes) -> nn.TransformerEncoderLayer:
    """A layer of self-attention."""
    arguments = sizes.width, sizes.heads, sizes.inner, sizes.dropout
    return nn.TransformerEncoderLayer(*arguments, activation="gelu", batch_first=True)


def decoder_layer(sizes: TransformerSizes) -> nn.TransformerDecoderLayer:
    """A layer of self-attention and cross-attention."""
    arguments = sizes.width, sizes.heads, sizes.inner, sizes.dropout
    return nn.TransformerDecoderLayer(*arguments, activation="gelu", batch_first=True)


def encoder(sizes: TransformerSizes) -> nn.TransformerEncoder:
    """Layers of self-attention."""
    return nn.TransformerEncoder(encoder_layer(sizes), sizes.layers, enable_nested_tensor=False)


def with_inputs(network: Callable[..., Tensor], *inputs: Tensor) -> ConditionalNetwork:
    """A network with these further inputs for each motion, repeated where guidance repeats the batch."""
    return lambda noisy, steps, conditions: network(
        noisy, steps, conditions, *(torch.cat([each] * (len(noisy) // len(each))) for each in inputs)
    )


def noised(clean: Rows, config: DiffusionConfig, generator: torch.Generator) -> tuple[Rows, Steps, Rows]:
    """Noise each motion to a random step, drawn on the CPU; gives noisy motions, steps and noise on their device."""
    steps = torch.randint(config.num_steps, (len(clean),), generator=generator).to(clean.device)
    noise = torch.randn(clean.shape, generator=generator).to(clean.device)
    alphas = networks.cumulative_alphas(config).to(clean.device)
    return networks.add_noise(clean.flatten(1), noise.flatten(1), steps, alphas).view(clean.shape), steps, noise


def diffusion_loss(
    network: ConditionalNetwork, config: DiffusionConfig, batch: MotionBatch, clean: Rows, mask: Mask
) -> Float[Tensor, ""]:
    """Squared error of the prediction at random steps, averaged over each motion's valid frames, then over motions."""
    alphas = networks.cumulative_alphas(config).to(clean.device)
    noisy, steps, noise = noised(clean, config, batch.generator)
    target = networks.prediction_target(config.prediction, clean.flatten(1), noise.flatten(1), steps, alphas)
    predicted = network(noisy * mask[..., None], steps, batch.conditions).float()
    errors = (predicted - target.view(clean.shape)).square().mean(dim=-1) * mask
    return (errors.sum(dim=1) / mask.sum(dim=1)).mean()


@torch.inference_mode()
def diffusion_sample(network: ConditionalNetwork, batch: SampleBatch, draw: Callable[[], Rows]) -> Rows:
    """Sample clean motions or latents, float64; `draw` returns fresh noise."""
    config, start = batch.diffusion, draw()
    alphas = networks.cumulative_alphas(config)

    def predict_noise(flat: Tensor, steps: Tensor) -> Tensor:
        noisy, at = flat.view(start.shape).float(), steps.to(start.device)
        output = guided(network, noisy, at, batch.conditions, batch.unconditional, config.guidance_scale)
        alpha = float(alphas[int(steps[0])])
        return networks.predicted_noise(config.prediction, output.double().flatten(1), flat, alpha)

    draw_noise = (lambda: draw().flatten(1)) if config.sampler == "ddpm" else None
    steps = networks.sampling_steps(config)
    return networks.sample(predict_noise, start.flatten(1), alphas, steps, draw_noise=draw_noise).view(start.shape)
