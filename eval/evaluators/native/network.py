"""The native-rate evaluator's network: Guo et al.'s movement and motion encoders, made small (evaluator of clips).

Two convolutions of kernel 4 and stride 2, a bidirectional GRU, one embedding; from it linear heads for the strength of
every kind of damage, and a projection into a space shared with sentences.
Architecture after text-to-motion (networks/modules.py), on inputs per second.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from eval.evaluators.native.config import NativeNetworkConfig
from eval.evaluators.native.input import NUM_CHANNELS

TARGETS = ("upsampling", "foot-sliding", "jitter", "low-pass")
"""What the heads regress: log strengths of damage."""


class NativeNetwork(nn.Module):
    """Clips' standardised rich inputs [B, m, 229] → embeddings [B, D]."""

    def __init__(self, config: NativeNetworkConfig) -> None:
        super().__init__()
        self.convolutions = nn.Sequential(
            nn.Conv1d(NUM_CHANNELS, config.convolution, kernel_size=4, stride=2, padding=1),
            nn.LeakyReLU(0.2),
            nn.Conv1d(config.convolution, config.convolution, kernel_size=4, stride=2, padding=1),
            nn.LeakyReLU(0.2),
        )
        self.recurrent = nn.GRU(config.convolution, config.recurrent, batch_first=True, bidirectional=True)
        self.embedding = nn.Linear(2 * config.recurrent + config.convolution, config.embedding)
        self.strengths = nn.Linear(config.embedding, len(TARGETS))
        self.shared = nn.Linear(config.embedding, config.shared)

    def forward(self, inputs: Float[Tensor, "clips poses channels"]) -> Float[Tensor, "clips features"]:
        """One embedding per clip; all clips of a batch have the same number of poses, at least 8."""
        movements = self.convolutions(inputs.transpose(1, 2)).transpose(1, 2)
        _, last = self.recurrent(movements)
        # The mean over time beside the last states: strengths are averages, and a GRU forgets a long clip's beginning.
        summary = torch.cat((last[0], last[1], movements.mean(dim=1)), dim=-1)
        embeddings: Tensor = self.embedding(summary)
        return embeddings


class TextProjection(nn.Module):
    """Sentence embeddings → the space shared with motions."""

    def __init__(self, text_dimension: int, config: NativeNetworkConfig) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(text_dimension, config.text_hidden),
            nn.LeakyReLU(0.2),
            nn.Linear(config.text_hidden, config.shared),
        )

    def forward(self, sentences: Float[Tensor, "texts text"]) -> Float[Tensor, "texts shared"]:
        """One row per sentence."""
        projected: Tensor = self.layers(sentences)
        return projected
