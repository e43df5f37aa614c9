"""What the networks of generative systems share: their interface, layers, diffusion of motions and latents."""

import math
from dataclasses import dataclass
from typing import TypeVar

import torch
from torch import Tensor, nn

from motionkit.core.shapes import Float, Int64, Shaped
from motionkit.training.config import DiffusionConfig
from motionkit.training.networks import Conditions, ConditionSizes
from peers.motions import MotionBatch, PoseSpace, Rows, SampleBatch

Latents = Float[Tensor, "batch width"]  # one vector of each motion
Steps = Int64[Tensor, "batch"]  # the diffusion step of each motion
Tokens = Float[Tensor, "batch tokens width"]
Layer = TypeVar("Layer", nn.TransformerEncoderLayer, nn.TransformerDecoderLayer)


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


def attention(layer: type[Layer], sizes: TransformerSizes) -> Layer:
    """A layer of self-attention (torch's `TransformerEncoderLayer`), or of cross-attention too (the decoder's)."""
    arguments = sizes.width, sizes.heads, sizes.inner, sizes.dropout
    return layer(*arguments, activation="gelu", batch_first=True)


def encoder(sizes: TransformerSizes) -> nn.TransformerEncoder:
    """Layers of self-attention."""
    return nn.TransformerEncoder(attention(nn.TransformerEncoderLayer, sizes), sizes.layers, enable_nested_tensor=False)
