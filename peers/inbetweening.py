"""Δ-Interp and TS-Former, transformers that fill a gap in the frames.

Δ-Interp: given frames attend to each other, missing ones to the given, all relative to the last given frame.
TS-Former: a context transformer drafts the missing frames, a detail transformer refines them.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from motionkit.core.shapes import Bool, Float
from motionkit.training.config import Schedule
from pahires.temporal.network import ObservedWindow
from pahires.temporal.settings import AnswerSettings, TemporalSettings, base_training, nano_training
from peers.completing import IN_BETWEENING, completing_system, gathered, longest_gap, neighbours, on_task

# The framerate whose frames both count in.
FRAMES_PER_SECOND = 30.0
# A row begins with the root's position (motionkit.features.rotations).
ROOT_NUMBERS = 3
_ROUNDING_FRAMES = 1e-3
# Distances are rounded to this share of a frame.
STEPS_A_FRAME = 1000
Rows = Float[Tensor, "batch _ width"]
ByDistance = Callable[[Tensor], Tensor]  # queries [batch, heads, rows, width] → scores [batch, heads, rows, keys]


@dataclass(frozen=True)
class DeltaInterpNetworkConfig:
    """Δ-Interp: `blocks` of attention and residual layers, shared by given and missing frames.

    A position is a frame of 30 fps; the tables of learned positions and lengths have `positions` rows.
    """

    width: int = 1024
    blocks: int = 6
    layers: int = 3
    heads: int = 8
    embedding: int = 32
    positions: int = 256
    dropout: float = 0.2


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
        length = self.length((gap_end - gap_start) * FRAMES_PER_SECOND - 1)

        def entered(layer: nn.Module, poses: Tensor, times_seconds: Tensor) -> Tensor:
            position = self.position((times_seconds - start) * FRAMES_PER_SECOND)
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

    def forward(self, queries: Rows, keys: Rows) -> Rows:
        """The queries after attention to the keys and the residual MLP."""
        attended, _ = self.attention(queries, keys, keys, need_weights=False)
        hidden = torch.relu(self.norm(queries + attended))
        changed: Tensor = self.residual(hidden)
        return hidden + changed


@dataclass(frozen=True)
class TsFormerNetworkConfig:
    """TS-Former: two transformer encoders of the same size, context and detail."""

    width: int = 512
    layers: int = 6
    heads: int = 8
    head_width: int = 64
    inner: int = 512


class TsFormer(nn.Module):
    """TS-Former (Qin et al. 2022, doi 10.1145/3550454.3555454; victorqin/motion_inbetweening).

    Context: missing frames enter as zeros with the root on a straight line, a flag for given frames and an embedding
    of the distances to both ends of the gap, and attend to given frames only. Detail: given frames and the drafts of
    all missing ones attend to each other, and its output is added to the draft.

    Missing frames lie on a grid of 30 fps from the window's first frame to its last. Queried instants
    attend to them but are not attended to, so an output does not depend on the other queries.
    """

    def __init__(self, config: TsFormerNetworkConfig, numbers: int) -> None:
        super().__init__()
        self.keyframe_position = nn.Sequential(
            nn.Linear(2, config.width), nn.PReLU(), nn.Linear(config.width, config.width)
        )
        self.context = RelativeEncoder(numbers + 1, numbers, config)
        self.detail = RelativeEncoder(numbers + 1, numbers, config)

    def forward(self, window: ObservedWindow) -> Float[Tensor, "batch queries numbers"]:
        """Normalised pose vectors at the queries."""
        given = window.frames.shape[1]
        grid, on_grid = missing_instants(window)
        instants = torch.cat((grid, window.queries_seconds), dim=1)
        times, (_, gap_start, gap_end) = torch.cat((window.times_seconds, instants), dim=1), longest_gap(window)
        positions = (times - window.times_seconds[:, :1]) * FRAMES_PER_SECOND
        ends = torch.stack((times - gap_start, gap_end - times), dim=-1)
        observed = torch.ones_like(window.times_seconds, dtype=torch.bool)

        # Zeros, with the root on straight lines between observed frames.
        near = neighbours(window.at(instants))
        lines = near.mixed(gathered(window.frames, near.rows))
        placeholders = lines * (torch.arange(lines.shape[-1], device=lines.device) < ROOT_NUMBERS)
        entered = _marked(torch.cat((window.frames, placeholders), dim=1), given)
        keyframe_positions = self.keyframe_position(ends * FRAMES_PER_SECOND)
        draft = self.context(entered, positions, observed, added=keyframe_positions)[:, given:]
        entered = _marked(torch.cat((window.frames, draft), dim=1), given)
        refined = self.detail(entered, positions, torch.cat((observed, on_grid), dim=1))[:, given:]
        outputs: Tensor = (draft + refined)[:, grid.shape[1] :]
        return outputs


def missing_instants(window: ObservedWindow) -> tuple[Float[Tensor, "batch grid"], Bool[Tensor, "batch grid"]]:
    """The instants t_0 + k/fps of each window that lie in its span and at no observed frame.

    An instant less than half a frame from an observed one counts as observed. Windows with fewer missing instants than
    others are padded; the second output is the mask of missing ones.
    """
    times = window.times_seconds
    span_frames = (times[:, -1] - times[:, 0]) * FRAMES_PER_SECOND
    steps = torch.arange(int(torch.round(span_frames.max())) + 1, device=times.device, dtype=times.dtype)
    grid = times[:, :1] + steps / FRAMES_PER_SECOND
    off = (grid[:, :, None] - times[:, None]).abs().amin(dim=2) * FRAMES_PER_SECOND
    missing = (off >= 0.5 - _ROUNDING_FRAMES) & (grid <= times[:, -1:] + _ROUNDING_FRAMES / FRAMES_PER_SECOND)
    most = int(missing.sum(dim=1).max())
    first = torch.argsort((~missing).to(torch.int8), dim=1, stable=True)[:, :most]
    return grid.gather(1, first), missing.gather(1, first)


def _marked(poses: Float[Tensor, "batch rows numbers"], given: int) -> Float[Tensor, "batch rows inputs"]:
    """Append a flag to the poses: 1 for the first `given`, which are known, 0 for the others."""
    mark = (torch.arange(poses.shape[1], device=poses.device) < given).to(poses.dtype)
    return torch.cat((poses, mark[:, None].expand(*poses.shape[:2], 1)), dim=-1)


class EncoderLayer(nn.Module):
    """Multi-head attention with scores q·k + q·r(Δ), r a learned function of the distance (Qin et al. 2022, Eq. 5),
    and a feed-forward part, each after a layer norm and with its input added.

    As in the authors' code projections have no bias, and scores are divided by the root of the model's width.
    """

    def __init__(self, config: TsFormerNetworkConfig) -> None:
        super().__init__()
        width, inner = config.width, config.heads * config.head_width
        self.heads, self.scale = config.heads, 1 / math.sqrt(width)
        self.query, self.key, self.value = (nn.Linear(width, inner, bias=False) for _ in range(3))
        self.out = nn.Linear(inner, width, bias=False)
        self.before_attention, self.before_inner = nn.LayerNorm(width), nn.LayerNorm(width)
        self.inner = nn.Sequential(nn.Linear(width, config.inner), nn.ReLU(), nn.Linear(config.inner, width))

    def forward(self, rows: Rows, by_distance: ByDistance, visible: Bool[Tensor, "batch keys"]) -> Rows:
        """All rows after attention to the first, as many as `visible` is long."""
        normed = self.before_attention(rows)
        keys = normed[:, : visible.shape[1]]
        query, key, value = (
            layer(what).unflatten(-1, (self.heads, -1)).transpose(1, 2)
            for layer, what in ((self.query, normed), (self.key, keys), (self.value, keys))
        )
        scores = (query @ key.transpose(-1, -2) + by_distance(query)) * self.scale
        weights = scores.masked_fill(~visible[:, None, None], -torch.inf).softmax(dim=-1)
        rows = rows + self.out((weights @ value).transpose(1, 2).flatten(2))
        changed: Tensor = self.inner(self.before_inner(rows))
        return rows + changed


class RelativeEncoder(nn.Module):
    """Input MLP, encoder layers that share one embedding of distances, output MLP (Qin et al. 2022, Fig. 2)."""

    def __init__(self, inputs: int, outputs: int, config: TsFormerNetworkConfig) -> None:
        super().__init__()
        width, size = config.width, config.head_width
        self.enter = nn.Sequential(nn.Linear(inputs, width), nn.PReLU(), nn.Linear(width, width), nn.PReLU())
        self.distance = nn.Sequential(nn.Linear(1, size), nn.PReLU(), nn.Linear(size, size))
        self.layers = nn.ModuleList(EncoderLayer(config) for _ in range(config.layers))
        self.norm = nn.LayerNorm(width)
        self.leave = nn.Sequential(nn.Linear(width, width), nn.PReLU(), nn.Linear(width, outputs))

    def forward(
        self,
        inputs: Float[Tensor, "batch rows inputs"],
        positions: Float[Tensor, "batch rows"],
        visible: Bool[Tensor, "batch keys"],
        added: Rows | float = 0.0,
    ) -> Float[Tensor, "batch rows outputs"]:
        """An output per row; the first rows, as many as `visible` is long, are the keys that all attend to.

        A row's output depends on itself and the keys, not on other rows. `added` is added after the input MLP.
        """
        rows = self.enter(inputs) + added
        by_distance = self._by_distance(positions[:, None, : visible.shape[1]] - positions[:, :, None])
        for layer in self.layers:
            rows = layer(rows, by_distance, visible)
        outputs: Tensor = self.leave(self.norm(rows))
        return outputs

    def _by_distance(self, apart: Float[Tensor, "batch rows keys"]) -> ByDistance:
        """q·r of pairs that are so many frames apart.

        r is learned at whole distances, as in a frame-based model, and linear in between: a table of whole distances is
        small, while a vector per pair would dominate the cost.
        """
        farthest = int(apart.detach().abs().max().ceil()) + 1
        whole = torch.arange(-farthest, farthest + 1, device=apart.device, dtype=apart.dtype)
        table: Tensor = self.distance(whole[:, None])
        # Times are rounded: an almost whole distance is whole.
        apart = torch.round(apart * STEPS_A_FRAME) / STEPS_A_FRAME
        below, share = (apart.floor().long() + farthest)[:, None], (apart - apart.floor())[:, None]
        all_whole = not bool(share.any())

        def scores(query: Tensor) -> Tensor:
            each, at = query @ table.T, below.expand(-1, query.shape[1], -1, -1)
            nearest = each.gather(3, at)
            return nearest if all_whole else torch.lerp(nearest, each.gather(3, at + 1), share)

        return scores


# 300 epochs at 2e-4, a tenth of it after 200; gaps of 5 to 39 frames.
DELTA_PAPER = TemporalSettings(
    tasks=replace(IN_BETWEENING, longest_gap=39),
    answer=AnswerSettings(form="residual"),
    schedule=Schedule(epochs=300, learning_rate=2e-4, kind="steps", warmup_fraction=0.02, drop=0.1, drop_every=2 / 3),
)
DELTA_NANO, DELTA_BASE = (
    replace(on_task(IN_BETWEENING, training, rate), answer=AnswerSettings("residual", "slerp"))
    for training, rate in ((nano_training(), None), (base_training(), 2e-4))
)
DELTA_RECIPES = {
    "nano": (DeltaInterpNetworkConfig(96, 3, layers=2, heads=4, dropout=0.0), DELTA_NANO),
    "base": (DeltaInterpNetworkConfig(512), DELTA_BASE),
    "paper": (DeltaInterpNetworkConfig(), DELTA_PAPER),
}
DELTA_INTERP = completing_system("delta-interp", DeltaInterp, DELTA_RECIPES)

# 2,000 epochs at the 3.1e-5 that the published schedule peaks at; gaps of 5 to 30 frames.
TS_PAPER = TemporalSettings(
    tasks=replace(IN_BETWEENING, longest_gap=30),
    schedule=Schedule(epochs=2000, batch_size=32, learning_rate=3.1e-5, kind="cosine", warmup_fraction=0.02),
)
TS_RECIPES = {
    "nano": (TsFormerNetworkConfig(64, 2, 2, 32, inner=64), on_task(IN_BETWEENING, nano_training())),
    "base": (TsFormerNetworkConfig(256, 6, 8, 32, inner=256), on_task(IN_BETWEENING, base_training(), 2e-4)),
    "paper": (TsFormerNetworkConfig(), TS_PAPER),
}
TS_FORMER = completing_system("ts-former", TsFormer, TS_RECIPES)
