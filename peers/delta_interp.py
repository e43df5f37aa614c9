"""Δ-Interp: given frames attend to each other, missing ones to the given, all relative to the last given frame."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from motionkit.core.shapes import Float
from motionkit.training.config import Schedule
from pahires.temporal.network import ObservedWindow
from pahires.temporal.settings import AnswerSettings, TemporalSettings, base_training, nano_training
from peers.completing import IN_BETWEENING, completing_system, longest_gap, on_task

Tokens = Float[Tensor, "batch _ width"]


@dataclass(frozen=True)
class DeltaInterpNetworkConfig:
    """Δ-Interp: `blocks` of attention and residual layers, shared by given and missing frames.

    A position is a frame of `frames_per_second`; the tables of learned positions and lengths have `positions` rows.
    """

    width: int = 1024
    blocks: int = 6
    layers: int = 3
    heads: int = 8
    embedding: int = 32
    positions: int = 256
    dropout: float = 0.2
    frames_per_second: float = 30.0


class DeltaInterp(nn.Module):
    """Δ-Interp (Oreshkin et al. 2023, arXiv 2201.06701; boreshkinai/delta-interpolator).

    Given frames enter relative to the last one before the gap, missing ones as zeros, both with learned embeddings of
    their position and of the gap's length. Every block has one attention and one residual MLP for both: the given
    frames attend to themselves, the missing ones to the given. The output is meant as a correction to an interpolation
    (the `residual` setting of the training). A time between two frames gets their interpolated embedding.
    """

    def __init__(self, config: DeltaInterpNetworkConfig, numbers: int) -> None:
        super().__init__()
        inputs = numbers + 2 * config.embedding
        self.frames_per_second = config.frames_per_second
        self.position = PositionTable(config.positions, config.embedding)
        self.length = PositionTable(config.positions, config.embedding)
        self.given, self.missing = nn.Linear(inputs, config.width), nn.Linear(inputs, config.width)
        self.blocks = nn.ModuleList(
            Block(config.width, config.heads, config.layers, config.dropout) for _ in range(config.blocks)
        )
        self.output = nn.Linear(config.width, numbers)

    def forward(self, window: ObservedWindow) -> Float[Tensor, "batch queries numbers"]:
        """Normalised pose vectors at the queries, or what is to be added to an interpolation."""
        (before, gap_start, gap_end), start = longest_gap(window), window.times_seconds[:, :1]
        reference = window.frames[torch.arange(len(window.frames), device=window.frames.device), before]
        length = self.length((gap_end - gap_start) * self.frames_per_second - 1)

        def entered(layer: nn.Module, poses: Tensor, times_seconds: Tensor) -> Tensor:
            position = self.position((times_seconds - start) * self.frames_per_second)
            rows: Tensor = layer(torch.cat((poses, position, length.expand(position.shape)), dim=-1))
            return rows

        given = entered(self.given, window.frames - reference[:, None], window.times_seconds)
        nothing = window.frames.new_zeros(*window.queries_seconds.shape, window.frames.shape[-1])
        missing = entered(self.missing, nothing, window.queries_seconds)
        for block in self.blocks:
            given = block(given, given)
            missing = block(missing, given)
        outputs: Tensor = self.output(missing)
        return outputs


class PositionTable(nn.Module):
    """A learned vector per whole position, interpolated linearly in between and clamped outside the table."""

    def __init__(self, positions: int, numbers: int) -> None:
        super().__init__()
        # A one-hot vector through a linear layer, as the authors have it: rows of a matrix, and one bias.
        self.projection = nn.Linear(positions, numbers)

    def forward(self, positions: Float[Tensor, "*some"]) -> Float[Tensor, "*some numbers"]:
        """Embeddings of positions, whole or between."""
        table = self.projection.weight.T
        inside = positions.clamp(0, len(table) - 1)
        below = inside.floor().long().clamp(max=len(table) - 2)
        share = (inside - below)[..., None]
        return (1 - share) * table[below] + share * table[below + 1] + self.projection.bias


class Block(nn.Module):
    """Multi-head attention, its input added, layer norm, ReLU, and a residual MLP with leaky ReLU."""

    def __init__(self, width: int, heads: int, layers: int, dropout: float) -> None:
        super().__init__()
        self.attention = nn.MultiheadAttention(width, heads, batch_first=True)
        self.norm = nn.LayerNorm(width)
        hidden = [layer for _ in range(layers) for layer in (nn.Linear(width, width), nn.LeakyReLU())]
        self.residual = nn.Sequential(*hidden[:2], nn.Dropout(dropout), *hidden[2:])

    def forward(self, queries: Tokens, keys: Tokens) -> Tokens:
        """The queries after attention to the keys and the residual MLP."""
        attended, _ = self.attention(queries, keys, keys, need_weights=False)
        hidden = torch.relu(self.norm(queries + attended))
        changed: Tensor = self.residual(hidden)
        return hidden + changed


# 300 epochs at 2e-4, a tenth of it after 200; gaps of 5 to 39 frames.
PAPER = TemporalSettings(
    tasks=replace(IN_BETWEENING, longest_gap=39),
    answer=AnswerSettings(form="residual"),
    schedule=Schedule(epochs=300, learning_rate=2e-4, kind="steps", warmup_fraction=0.02, drop=0.1, drop_every=2 / 3),
)
NANO, BASE = (
    replace(on_task(IN_BETWEENING, training, rate), answer=AnswerSettings("residual", "slerp"))
    for training, rate in ((nano_training(), None), (base_training(), 2e-4))
)
RECIPES = {
    "nano": (DeltaInterpNetworkConfig(96, 3, layers=2, heads=4, dropout=0.0), NANO),
    "base": (DeltaInterpNetworkConfig(512), BASE),
    "paper": (DeltaInterpNetworkConfig(), PAPER),
}
DELTA_INTERP = completing_system("delta-interp", DeltaInterp, RECIPES)
