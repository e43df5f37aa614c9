"""What the systems that complete motion share: their declaration, trainings on one task, neighbouring frames.

They are published methods as one-dimensional networks over time (super-resolution of images; in-betweening), trained as
PA-HiRes is. `nano` and `base` train as PA-HiRes' recipes of the same names (windows, batch, form of the output), each
on its own task alone: `base` for as many steps as PA-HiRes spends on it, `nano` for two thirds of them. Blended curves
and corrections scaled by the motion are PA-HiRes' own. `paper` has the published sizes, windows and optimiser.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import torch
from torch import Tensor, nn

from motionkit.core.shapes import Float, Int
from motionkit.training.config import specialised
from pahires.temporal.network import ObservedWindow
from pahires.temporal.settings import TaskSettings, TemporalConfig, TemporalSettings
from pahires.temporal.system import TemporalSystem

# An instant this close to a frame, in frames, counts as that frame: times are rounded.
SNAP_FRAMES = 1e-4


@dataclass(frozen=True)
class PeerConfig(TemporalConfig):
    """A system's configuration: `network`, its sizes, and `training`."""

    def __post_init__(self) -> None:
        if self.training.answer.curves:
            raise ValueError("peers predict rows only, no weights of curves: leave training.answer.blended empty")


def completing_system(
    name: str, network: type[nn.Module], recipes: Mapping[str, tuple[object, TemporalSettings]]
) -> TemporalSystem:
    """The system of a network that is built from its sizes and the numbers per row; recipes are sizes and trainings."""
    description = (network.__doc__ or "").partition("\n")[0]
    config = specialised(PeerConfig, network.__name__ + "Config", network=type(recipes["paper"][0]))
    make = {recipe: partial(config, *sizes_and_training) for recipe, sizes_and_training in recipes.items()}
    return TemporalSystem(name, description, config, lambda of, numbers: network(of.network, numbers), make)


# Every s-th frame observed, s ~ U(1, 4), for Tables 1 and 2; a gap in the frames for Table 3.
INTERPOLATION, IN_BETWEENING = TaskSettings(interpolate=1.0), TaskSettings(interpolate=0.0, gap=1.0)


def on_task(task: TaskSettings, training: TemporalSettings, learning_rate: float | None = None) -> TemporalSettings:
    """The share of a training on all tasks that is on one task."""
    shares, schedule = training.tasks.shares, training.schedule
    kept = sum(share for share, own in zip(shares, task.shares, strict=True) if own) / sum(shares)
    steps, rate = round((schedule.steps or 0) * kept), learning_rate or schedule.learning_rate
    tasks = replace(task, num_frames=training.tasks.num_frames, num_queries=training.tasks.num_queries)
    return replace(training, tasks=tasks, schedule=replace(schedule, steps=steps, learning_rate=rate))


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

    def places(self, cell: Float[Tensor, "batch"]) -> Float[Tensor, "2 batch queries 2"]:
        """Relative time and a cell of each query."""
        return torch.stack((self.relative, cell[:, None].expand(self.relative.shape)), dim=-1)

    def mixed(self, values: Float[Tensor, "2 batch queries numbers"]) -> Float[Tensor, "batch queries numbers"]:
        """The weighted sum of values at both neighbours."""
        return torch.sum(self.weights[..., None] * values, dim=0)


def neighbours(window: ObservedWindow) -> Neighbours:
    """Both neighbours of each query; with a single frame the spacing Δ is the queries'."""
    times, queries = window.times_seconds, window.queries_seconds
    last = times.shape[1] - 1
    spacing = (times[:, -1] - times[:, 0]) / last if last else window.query_spacing_seconds
    after = torch.searchsorted(times.contiguous(), (queries + SNAP_FRAMES * spacing[:, None]).contiguous(), right=True)
    rows = torch.stack((after - 1, after)).clamp(0, last)
    at = torch.stack((times.gather(1, rows[0]), times.gather(1, rows[1])))
    gap = at[1] - at[0]
    share = torch.where(gap > 0, (queries - at[0]) / gap.clamp(min=torch.finfo(gap.dtype).tiny), 0.0).clamp(0, 1)
    weights, cell = torch.stack((1 - share, share)), window.query_spacing_seconds / spacing
    return Neighbours(rows, (queries - at) / spacing[:, None], weights, cell)


def gathered(
    codes: Float[Tensor, "batch frames features"], rows: Int[Tensor, "*two batch queries"]
) -> Float[Tensor, "*two batch queries features"]:
    """Gather the codes of these rows."""
    return codes[torch.arange(len(codes), device=codes.device)[:, None], rows]


def longest_gap(
    window: ObservedWindow,
) -> tuple[Int[Tensor, "batch"], Float[Tensor, "batch 1"], Float[Tensor, "batch 1"]]:
    """The observed frame before each window's longest gap (the first of several), and the times at both its ends.

    A window of one frame has a gap of no length at that frame.
    """
    times = window.times_seconds
    # Rounding of times must not decide between equal gaps: frames are milliseconds apart.
    gaps = torch.round(torch.diff(times, dim=1, append=times[:, -1:]) * 1e4)
    before = torch.argmax(gaps, dim=1, keepdim=True)
    after = (before + 1).clamp(max=times.shape[1] - 1)
    return before[:, 0], times.gather(1, before), times.gather(1, after)
