"""Transformer encoder layers with attention relative to the signed distance in time between rows."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from motionkit.core.shapes import Bool, Float, Int
from pahires.temporal.network import ObservedWindow

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

    def __init__(self, width: int, heads: int, head_width: int) -> None:
        super().__init__()
        self.heads, self.scale = heads, 1 / math.sqrt(width)
        self.query, self.key, self.value = (nn.Linear(width, heads * head_width, bias=False) for _ in range(3))
        self.out = nn.Linear(heads * head_width, width, bias=False)

    def forward(
        self,
        rows: Float[Tensor, "batch rows width"],
        keys: Float[Tensor, "batch keys width"],
        distances: Distances,
        visible: Bool[Tensor, "batch keys"],
    ) -> Float[Tensor, "batch rows width"]:
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

    def __init__(self, width: int, heads: int, head_width: int, inner: int) -> None:
        super().__init__()
        self.attention = RelativeAttention(width, heads, head_width)
        self.before_attention, self.before_inner = nn.LayerNorm(width), nn.LayerNorm(width)
        self.inner = nn.Sequential(nn.Linear(width, inner), nn.ReLU(), nn.Linear(inner, width))

    def forward(
        self,
        rows: Float[Tensor, "batch rows width"],
        num_keys: int,
        distances: Distances,
        visible: Bool[Tensor, "batch keys"],
    ) -> Float[Tensor, "batch rows width"]:
        """All rows after attention to the first `num_keys` of them."""
        normed = self.before_attention(rows)
        rows = rows + self.attention(normed, normed[:, :num_keys], distances, visible)
        changed: Tensor = self.inner(self.before_inner(rows))
        return rows + changed


class RelativeEncoder(nn.Module):
    """Input MLP, encoder layers that share one embedding of distances, output MLP (Qin et al. 2022, Fig. 2)."""

    def __init__(
        self, inputs: int, outputs: int, *, width: int, layers: int, heads: int, head_width: int, inner: int
    ) -> None:
        super().__init__()
        self.enter = nn.Sequential(nn.Linear(inputs, width), nn.PReLU(), nn.Linear(width, width), nn.PReLU())
        self.distance = nn.Sequential(nn.Linear(1, head_width), nn.PReLU(), nn.Linear(head_width, head_width))
        self.layers = nn.ModuleList(EncoderLayer(width, heads, head_width, inner) for _ in range(layers))
        self.norm = nn.LayerNorm(width)
        self.leave = nn.Sequential(nn.Linear(width, width), nn.PReLU(), nn.Linear(width, outputs))

    def forward(
        self,
        inputs: Float[Tensor, "batch rows inputs"],
        positions: Float[Tensor, "batch rows"],
        visible: Bool[Tensor, "batch keys"],
        added: Float[Tensor, "batch rows width"] | None = None,
    ) -> Float[Tensor, "batch rows outputs"]:
        """An output per row; the first rows, as many as `visible` is long, are the keys that all attend to.

        A row's output depends on itself and the keys, not on other rows. `added` is added after the input MLP.
        """
        num_keys = visible.shape[1]
        rows = self.enter(inputs)
        rows = rows if added is None else rows + added
        distances = self._distances(positions[:, None, :num_keys] - positions[:, :, None])
        for layer in self.layers:
            rows = layer(rows, num_keys, distances, visible)
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


@dataclass(frozen=True, eq=False)
class Gap:
    """The observed frames on both sides of each window's longest gap (the first of several), and their times.

    A window of one frame has a gap of no length at that frame.
    """

    before: Int[Tensor, "batch"]
    before_seconds: Float[Tensor, "batch"]
    after_seconds: Float[Tensor, "batch"]


def longest_gap(window: ObservedWindow) -> Gap:
    """The longest gap of each window."""
    times = window.times_seconds
    last = times.shape[1] - 1
    # Rounding of times must not decide between equal gaps: frames are milliseconds apart.
    gaps = torch.round(torch.diff(times, dim=1, append=times[:, -1:]) * 1e4)
    before = torch.argmax(gaps, dim=1)
    after = (before + 1).clamp(max=last)
    return Gap(before, *(times.gather(1, row[:, None])[:, 0] for row in (before, after)))
