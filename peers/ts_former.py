"""TS-Former: a context transformer drafts the missing frames, a detail transformer refines them."""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from motionkit.core.shapes import Bool, Float, Int
from motionkit.training.config import Schedule
from pahires.temporal.network import ObservedWindow
from pahires.temporal.settings import TemporalSettings
from peers.completing import BASE_GAPS, IN_BETWEENING, NANO_GAPS, completing_system, gathered, longest_gap, neighbours

# A row begins with the root's position (motionkit.features.rotations).
ROOT_NUMBERS = 3
_ROUNDING_FRAMES = 1e-3
Rows = Float[Tensor, "batch _ width"]


@dataclass(frozen=True)
class TsFormerNetworkConfig:
    """TS-Former: two transformer encoders of the same size, context and detail."""

    width: int = 512
    layers: int = 6
    heads: int = 8
    head_width: int = 64
    inner: int = 512
    frames_per_second: float = 30.0


class TsFormer(nn.Module):
    """TS-Former (Qin et al. 2022, doi 10.1145/3550454.3555454; victorqin/motion_inbetweening).

    Context: missing frames enter as zeros with the root on a straight line, a flag for given frames and an embedding
    of the distances to both ends of the gap, and attend to given frames only. Detail: given frames and the drafts of
    all missing ones attend to each other, and its output is added to the draft.

    Missing frames lie on a grid of `frames_per_second` from the window's first frame to its last. Queried instants
    attend to them but are not attended to, so an output does not depend on the other queries.
    """

    def __init__(self, config: TsFormerNetworkConfig, numbers: int) -> None:
        super().__init__()
        self.frames_per_second = config.frames_per_second
        self.keyframe_position = nn.Sequential(
            nn.Linear(2, config.width), nn.PReLU(), nn.Linear(config.width, config.width)
        )
        self.context = RelativeEncoder(numbers + 1, numbers, config)
        self.detail = RelativeEncoder(numbers + 1, numbers, config)

    def forward(self, window: ObservedWindow) -> Float[Tensor, "batch queries numbers"]:
        """Normalised pose vectors at the queries."""
        given = window.frames.shape[1]
        grid, on_grid = missing_instants(window, self.frames_per_second)
        instants = torch.cat((grid, window.queries_seconds), dim=1)
        times, gap = torch.cat((window.times_seconds, instants), dim=1), longest_gap(window)
        positions = (times - window.times_seconds[:, :1]) * self.frames_per_second
        ends = torch.stack((times - gap.before_seconds[:, None], gap.after_seconds[:, None] - times), dim=-1)
        observed = torch.ones_like(window.times_seconds, dtype=torch.bool)

        # Zeros, with the root on straight lines between observed frames.
        near = neighbours(window.at(instants))
        lines = near.mixed(gathered(window.frames, near.rows))
        placeholders = lines * (torch.arange(lines.shape[-1], device=lines.device) < ROOT_NUMBERS)
        entered = _marked(torch.cat((window.frames, placeholders), dim=1), given)
        keyframe_positions = self.keyframe_position(ends * self.frames_per_second)
        draft = self.context(entered, positions, observed, added=keyframe_positions)[:, given:]
        entered = _marked(torch.cat((window.frames, draft), dim=1), given)
        refined = self.detail(entered, positions, torch.cat((observed, on_grid), dim=1))[:, given:]
        outputs: Tensor = (draft + refined)[:, grid.shape[1] :]
        return outputs


def missing_instants(
    window: ObservedWindow, frames_per_second: float
) -> tuple[Float[Tensor, "batch grid"], Bool[Tensor, "batch grid"]]:
    """The instants t_0 + k/fps of each window that lie in its span and at no observed frame.

    An instant less than half a frame from an observed one counts as observed. Windows with fewer missing instants than
    others are padded; the second output is the mask of missing ones.
    """
    times = window.times_seconds
    span_frames = (times[:, -1] - times[:, 0]) * frames_per_second
    steps = torch.arange(int(torch.round(span_frames.max())) + 1, device=times.device, dtype=times.dtype)
    grid = times[:, :1] + steps / frames_per_second
    off = (grid[:, :, None] - times[:, None]).abs().amin(dim=2) * frames_per_second
    missing = (off >= 0.5 - _ROUNDING_FRAMES) & (grid <= times[:, -1:] + _ROUNDING_FRAMES / frames_per_second)
    most = int(missing.sum(dim=1).max())
    first = torch.argsort((~missing).to(torch.int8), dim=1, stable=True)[:, :most]
    return grid.gather(1, first), missing.gather(1, first)


def _marked(poses: Float[Tensor, "batch rows numbers"], given: int) -> Float[Tensor, "batch rows inputs"]:
    """Append a flag to the poses: 1 for the first `given`, which are known, 0 for the others."""
    mark = (torch.arange(poses.shape[1], device=poses.device) < given).to(poses.dtype)
    return torch.cat((poses, mark[:, None].expand(*poses.shape[:2], 1)), dim=-1)


# Distances are rounded to this share of a frame.
STEPS_A_FRAME = 1000


@dataclass(frozen=True, eq=False)
class Distances:
    """A table of learned vectors for whole distances, and each pair's position between two of them.

    A pair at `below` + `share` gets the linear interpolation of both vectors. At whole distances, as in a frame-based
    model, that is the learned vector; if all pairs are at such, the second is not looked up. The table is small; a
    vector per pair would dominate the cost.
    """

    table: Float[Tensor, "distances head_width"]
    below: Int[Tensor, "batch rows keys"]
    share: Float[Tensor, "batch rows keys"]
    all_whole: bool

    def scores(self, query: Float[Tensor, "batch heads rows head_width"]) -> Float[Tensor, "batch heads rows keys"]:
        """q·r of each row and key."""
        each = query @ self.table.T
        heads = (-1, query.shape[1], -1, -1)
        below = self.below[:, None].expand(heads)
        nearest = each.gather(3, below)
        return nearest if self.all_whole else torch.lerp(nearest, each.gather(3, below + 1), self.share[:, None])


class RelativeAttention(nn.Module):
    """Multi-head attention with scores q·k + q·r(Δ), r a learned function of the distance (Qin et al. 2022, Eq. 5).

    As in the authors' code projections have no bias, and scores are divided by the root of the model's width.
    """

    def __init__(self, config: TsFormerNetworkConfig) -> None:
        super().__init__()
        width, inner = config.width, config.heads * config.head_width
        self.heads, self.scale = config.heads, 1 / math.sqrt(width)
        self.query, self.key, self.value = (nn.Linear(width, inner, bias=False) for _ in range(3))
        self.out = nn.Linear(inner, width, bias=False)

    def forward(self, rows: Rows, keys: Rows, distances: Distances, visible: Bool[Tensor, "batch keys"]) -> Rows:
        """Attention of each row over the visible keys."""
        query, key, value = (
            layer(what).unflatten(-1, (self.heads, -1)).transpose(1, 2)
            for layer, what in ((self.query, rows), (self.key, keys), (self.value, keys))
        )
        scores = query @ key.transpose(-1, -2) + distances.scores(query)
        scores = (scores * self.scale).masked_fill(~visible[:, None, None], -torch.inf)
        attended: Tensor = self.out((scores.softmax(dim=-1) @ value).transpose(1, 2).flatten(2))
        return attended


class EncoderLayer(nn.Module):
    """Relative attention and a feed-forward part, each after a layer norm and with its input added."""

    def __init__(self, config: TsFormerNetworkConfig) -> None:
        super().__init__()
        width = config.width
        self.attention = RelativeAttention(config)
        self.before_attention, self.before_inner = nn.LayerNorm(width), nn.LayerNorm(width)
        self.inner = nn.Sequential(nn.Linear(width, config.inner), nn.ReLU(), nn.Linear(config.inner, width))

    def forward(self, rows: Rows, distances: Distances, visible: Bool[Tensor, "batch keys"]) -> Rows:
        """All rows after attention to the first, as many as `visible` is long."""
        normed = self.before_attention(rows)
        rows = rows + self.attention(normed, normed[:, : visible.shape[1]], distances, visible)
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
        distances = self._distances(positions[:, None, : visible.shape[1]] - positions[:, :, None])
        for layer in self.layers:
            rows = layer(rows, distances, visible)
        outputs: Tensor = self.leave(self.norm(rows))
        return outputs

    def _distances(self, apart: Float[Tensor, "batch rows keys"]) -> Distances:
        """Distances in frames, and the learned vectors of all whole ones up to the farthest."""
        farthest = int(apart.detach().abs().max().ceil()) + 1
        whole = torch.arange(-farthest, farthest + 1, device=apart.device, dtype=apart.dtype)
        # Times are rounded: an almost whole distance is whole.
        apart = torch.round(apart * STEPS_A_FRAME) / STEPS_A_FRAME
        below = apart.floor()
        share = apart - below
        return Distances(self.distance(whole[:, None]), below.long() + farthest, share, not bool(share.any()))


# 2,000 epochs at the 3.1e-5 that the published schedule peaks at; gaps of 5 to 30 frames.
PAPER = TemporalSettings(
    tasks=replace(IN_BETWEENING, longest_gap=30),
    schedule=Schedule(epochs=2000, batch_size=32, learning_rate=3.1e-5, kind="cosine", warmup_fraction=0.02),
)
TS_FORMER = completing_system(
    "ts-former",
    "TS-Former: in-betweening by a draft and its refinement",
    TsFormer,
    {
        "nano": (TsFormerNetworkConfig(width=64, layers=2, heads=2, head_width=32, inner=64), NANO_GAPS),
        "base": (TsFormerNetworkConfig(width=256, head_width=32, inner=256), BASE_GAPS),
        "paper": (TsFormerNetworkConfig(), PAPER),
    },
)
