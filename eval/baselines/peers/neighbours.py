"""Where queries lie among observed frames: the frame on each side, how far it is, how much it counts."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from pahires.network import ObservedWindow

# An instant this close to a frame, in frames, is that frame: times are rounded.
SNAP_FRAMES = 1e-4
# Every s-th real frame, s not whole, has gaps of ⌊s⌋ and ⌈s⌉; and times are rounded.
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
    """Both neighbours of each query of windows whose frames lie on a grid; raises `ValueError` where they do not.

    Convolutions know frames by their number only. Gaps may differ by a factor of two, as those of every 1.2-th frame.
    """
    gaps = torch.diff(window.times_seconds, dim=1)
    if gaps.numel() and float((gaps.amax(dim=1) / gaps.amin(dim=1)).max()) > LARGEST_GAP_RATIO:
        worst = int(torch.argmax(gaps.amax(dim=1) / gaps.amin(dim=1)))
        raise ValueError(
            f"this model needs frames at even times, but gaps between those given go from "
            f"{float(gaps[worst].min()):.4f} to {float(gaps[worst].max()):.4f} s: give it frames of one framerate, or "
            f"take a model that knows their times (pahires, delta-interp, ts-former)"
        )
    return neighbours(window)


def neighbours(window: ObservedWindow) -> Neighbours:
    """Both neighbours of each query of a window; a single frame's spacing is that of the queries."""
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
    """Mean spacing of the observed frames; of a single one the queries' spacing."""
    times = window.times_seconds
    if times.shape[1] == 1:
        return window.query_spacing_seconds
    return (times[:, -1] - times[:, 0]) / (times.shape[1] - 1)


def gathered(
    codes: Float[Tensor, "batch frames features"], rows: Int[Tensor, "*two batch queries"]
) -> Float[Tensor, "*two batch queries features"]:
    """The code of each of these rows."""
    batch = torch.arange(codes.shape[0], device=codes.device)[:, None]
    return codes[batch, rows]


def per_query(
    values: Float[Tensor, "batch"], rows: Int[Tensor, "*two batch queries"]
) -> Float[Tensor, "*two batch queries"]:
    """A window's number at all its queries."""
    return values[:, None].expand(rows.shape)
