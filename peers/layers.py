"""Shared layers of the one-dimensional networks: the EDSR-baseline encoder, local MLPs, neighbouring frames."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from motionkit.core.shapes import Float, Int
from pahires.temporal.network import ObservedWindow

KERNEL = 3


class EdsrEncoder(nn.Module):
    """One feature vector per frame: head, `blocks` residual blocks, tail, and a skip from the head (EDSR, Lim 2017).

    As in EDSR-baseline, without normalisation or residual scaling. Padding is by replication, since zeros are not a
    valid pose; EDSR pads images with zeros.
    """

    def __init__(self, numbers: int, features: int, blocks: int) -> None:
        super().__init__()
        self.head = _convolution(numbers, features)
        self.blocks = nn.ModuleList(ResidualBlock(features) for _ in range(blocks))
        self.tail = _convolution(features, features)

    def forward(self, frames: Float[Tensor, "batch frames numbers"]) -> Float[Tensor, "batch frames features"]:
        """Features at the observed frames."""
        head = hidden = self.head(frames.transpose(1, 2))
        for block in self.blocks:
            hidden = block(hidden)
        features: Tensor = self.tail(hidden) + head
        return features.transpose(1, 2)


class ResidualBlock(nn.Module):
    """Convolution, ReLU, convolution, and the input added."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.first, self.second = _convolution(features, features), _convolution(features, features)

    def forward(self, hidden: Float[Tensor, "batch features frames"]) -> Float[Tensor, "batch features frames"]:
        """The block's output, channels before frames."""
        changed: Tensor = self.second(torch.relu(self.first(hidden)))
        return hidden + changed


def unfolded(features: Float[Tensor, "batch frames features"]) -> Float[Tensor, "batch frames three_features"]:
    """Each frame's features beside those of both neighbours (LIIF §3, feature unfolding), the ends replicated."""
    before = torch.cat((features[:, :1], features[:, :-1]), dim=1)
    after = torch.cat((features[:, 1:], features[:, -1:]), dim=1)
    return torch.cat((before, features, after), dim=-1)


def _convolution(inputs: int, outputs: int) -> nn.Conv1d:
    return nn.Conv1d(inputs, outputs, KERNEL, padding=KERNEL // 2, padding_mode="replicate")


def mlp(inputs: int, hidden: Sequence[int], outputs: int) -> nn.Sequential:
    """Linear layers of these widths, ReLU after all but the last."""
    widths = (inputs, *hidden)
    layers: list[nn.Module] = []
    for before, after in pairwise(widths):
        layers += [nn.Linear(before, after), nn.ReLU()]
    return nn.Sequential(*layers, nn.Linear(widths[-1], outputs))


# An instant this close to a frame, in frames, counts as that frame: times are rounded.
SNAP_FRAMES = 1e-4
# Every s-th frame, s not whole, gives gaps of ⌊s⌋ and ⌈s⌉; and times are rounded.
LARGEST_GAP_RATIO = 2.01


@dataclass(frozen=True, eq=False)
class Neighbours:
    """The frames before and after each query, in this order along the first axis.

    `relative` is (t − t_i)/Δ with Δ the mean spacing of the observed frames; `weights` sum to 1 and are the opposite
    frame's share of the gap (LIIF's local ensemble, Eq. 4, in one dimension); `cell` is the queries' spacing/Δ = 1/s.
    Beyond the first or last frame both neighbours are that frame.
    """

    rows: Int[Tensor, "2 batch queries"]
    relative: Float[Tensor, "2 batch queries"]
    weights: Float[Tensor, "2 batch queries"]
    cell: Float[Tensor, "batch"]


def even_neighbours(window: ObservedWindow) -> Neighbours:
    """Both neighbours of each query in windows of evenly spaced frames; raises `ValueError` for others.

    Convolutions only see frame indices. Gaps may differ by a factor of two, as those of every 1.2-th frame do.
    """
    gaps = torch.diff(window.times_seconds, dim=1)
    if gaps.numel() and float((gaps.amax(dim=1) / gaps.amin(dim=1)).max()) > LARGEST_GAP_RATIO:
        worst = int(torch.argmax(gaps.amax(dim=1) / gaps.amin(dim=1)))
        raise ValueError(
            f"this model needs evenly spaced frames, but the gaps between those given range from "
            f"{float(gaps[worst].min()):.4f} to {float(gaps[worst].max()):.4f} s: use frames of one framerate, or "
            f"a model that reads their times (pahires, delta-interp, ts-former)"
        )
    return neighbours(window)


def neighbours(window: ObservedWindow) -> Neighbours:
    """Both neighbours of each query; with a single frame the spacing is the queries'."""
    times, queries = window.times_seconds, window.queries_seconds
    last = times.shape[1] - 1
    spacing = frame_spacing_seconds(window)
    after = torch.searchsorted(times.contiguous(), (queries + SNAP_FRAMES * spacing[:, None]).contiguous(), right=True)
    rows = torch.stack((after - 1, after)).clamp(0, last)
    at = torch.stack((times.gather(1, rows[0]), times.gather(1, rows[1])))
    gap = at[1] - at[0]
    share = torch.where(gap > 0, (queries - at[0]) / gap.clamp(min=torch.finfo(gap.dtype).tiny), 0.0).clamp(0, 1)
    return Neighbours(
        rows=rows,
        relative=(queries - at) / spacing[:, None],
        weights=torch.stack((1 - share, share)),
        cell=window.query_spacing_seconds / spacing,
    )


def frame_spacing_seconds(window: ObservedWindow) -> Float[Tensor, "batch"]:
    """Mean spacing of the observed frames; with a single frame the queries' spacing."""
    times = window.times_seconds
    if times.shape[1] == 1:
        return window.query_spacing_seconds
    return (times[:, -1] - times[:, 0]) / (times.shape[1] - 1)


def gathered(
    codes: Float[Tensor, "batch frames features"], rows: Int[Tensor, "*two batch queries"]
) -> Float[Tensor, "*two batch queries features"]:
    """Gather the codes of these rows."""
    batch = torch.arange(codes.shape[0], device=codes.device)[:, None]
    return codes[batch, rows]


def per_query(
    values: Float[Tensor, "batch"], rows: Int[Tensor, "*two batch queries"]
) -> Float[Tensor, "*two batch queries"]:
    """Broadcast a per-window value to its queries."""
    return values[:, None].expand(rows.shape)
