"""The gap that in-betweening fills: the longest stretch without observed frames."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from pahires.network import ObservedWindow


@dataclass(frozen=True, eq=False)
class Gap:
    """The observed frames on both sides of each window's longest gap (the first of several), and their times.

    A window of one frame has a gap of no length at that frame.
    """

    before: Int[Tensor, "batch"]
    before_seconds: Float[Tensor, "batch"]
    after_seconds: Float[Tensor, "batch"]


def longest_gap(window: ObservedWindow) -> Gap:
    """Where the longest gap of each window lies."""
    times = window.times_seconds
    last = times.shape[1] - 1
    # A rounding of times must not decide which of equal gaps is taken: frames are milliseconds apart.
    gaps = torch.round(torch.diff(times, dim=1, append=times[:, -1:]) * 1e4)
    before = torch.argmax(gaps, dim=1)
    after = (before + 1).clamp(max=last)
    return Gap(before, *(times.gather(1, row[:, None])[:, 0] for row in (before, after)))
