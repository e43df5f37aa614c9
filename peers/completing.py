"""What the systems that complete motion share: their declaration, trainings on one task, layers, neighbouring frames.

They are published methods as one-dimensional networks over time (LIIF, Meta-SR, A-LIIF, LMF: image super-resolution;
Δ-Interp, TS-Former: in-betweening), trained as PA-HiRes is. `nano` and `base` train as PA-HiRes' recipes of the same
names (windows, batch, form of the output), each on its own task alone: `base` for as many steps as PA-HiRes spends on
it, `nano` for two thirds of them. Blended curves and corrections scaled by the motion are PA-HiRes' own. `paper` has
the published sizes, windows and optimiser.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import torch
from torch import Tensor, nn

from motionkit.core.shapes import Float, Int
from motionkit.training.config import Schedule, specialised
from pahires.temporal.network import ObservedWindow
from pahires.temporal.settings import TaskSettings, TemporalConfig, TemporalSettings, base_training, nano_training
from pahires.temporal.system import TemporalSystem


@dataclass(frozen=True)
class PeerConfig(TemporalConfig):
    """A system's configuration: `network`, its sizes, and `training`."""

    def __post_init__(self) -> None:
        if self.training.answer.curves:
            raise ValueError("peers predict rows only, no weights of curves: leave training.answer.blended empty")


@dataclass(frozen=True)
class GridConfig(PeerConfig):
    """The configuration of a network that needs evenly spaced frames."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.training.tasks.gap or self.training.tasks.scattered:
            raise ValueError(
                "this model needs evenly spaced frames: training.tasks.gap and training.tasks.scattered must be 0"
            )


def completing_system(
    name: str,
    description: str,
    network: type[nn.Module],
    base: type[PeerConfig],
    recipes: Mapping[str, tuple[object, TemporalSettings]],
) -> TemporalSystem:
    """The system of a network that is built from its sizes and the numbers per row.

    `recipes` are sizes and trainings by name; `base` is the configuration's type but for its sizes.
    """
    sizes = type(recipes["paper"][0])
    config = specialised(base, network.__name__ + "Config", network=sizes)
    make = {recipe: partial(config, *parts) for recipe, parts in recipes.items()}
    return TemporalSystem(name, description, config, lambda of, numbers: network(of.network, numbers), make)


# Every s-th frame observed, s ~ U(1, 4), for Tables 1 and 2; a gap in the frames for Table 3.
INTERPOLATION = TaskSettings(interpolate=1.0, gap=0.0, scattered=0.0, extend=0.0)
IN_BETWEENING = TaskSettings(interpolate=0.0, gap=1.0, scattered=0.0, extend=0.0)


def on_task(task: TaskSettings, training: TemporalSettings, learning_rate: float | None = None) -> TemporalSettings:
    """The part of a training on all tasks that is on one task."""
    steps, shares = training.schedule.steps, training.tasks.shares
    assert steps is not None
    kept = sum(share for share, own in zip(shares, task.shares, strict=True) if own)
    interpolate, gap, scattered, extend = task.shares
    return replace(
        training,
        tasks=replace(training.tasks, interpolate=interpolate, gap=gap, scattered=scattered, extend=extend),
        schedule=replace(
            training.schedule,
            steps=round(steps * kept / sum(shares)),
            learning_rate=learning_rate or training.schedule.learning_rate,
        ),
    )


NANO_GAPS, BASE_GAPS = on_task(IN_BETWEENING, nano_training()), on_task(IN_BETWEENING, base_training(), 2e-4)
# Adam at 1e-4, halved every 200 of 1,000 epochs, batches of 16 windows of 48 frames.
IMAGE_PAPER = TemporalSettings(
    tasks=replace(INTERPOLATION, num_frames=48, num_queries=48),
    schedule=Schedule(epochs=1000, batch_size=16, learning_rate=1e-4, kind="steps", warmup_fraction=0.02),
)


def image_system(
    name: str,
    description: str,
    network: type[nn.Module],
    *,
    nano: object,
    base: object,
    paper: object,
    nano_learning_rate: float | None = None,
) -> TemporalSystem:
    """A system made for super-resolution of images: it interpolates evenly spaced frames; sizes for each recipe."""
    trainings = {
        "nano": (nano, on_task(INTERPOLATION, nano_training(), nano_learning_rate)),
        "base": (base, on_task(INTERPOLATION, base_training())),
        "paper": (paper, IMAGE_PAPER),
    }
    return completing_system(name, description, network, GridConfig, trainings)


# For images of three colours 16 is published; for pose vectors of 135 numbers the width of the features is fair.
FAIR_WIDTH = 64
KERNEL = 3


@dataclass(frozen=True)
class EdsrConfig:
    """The shared encoder: EDSR-baseline's 16 residual blocks of 64 features (receptive field: 69 frames)."""

    blocks: int = 16
    features: int = 64


SMALL_ENCODER = EdsrConfig(blocks=4, features=64)


class EdsrEncoder(nn.Module):
    """One feature vector per frame: head, `blocks` residual blocks, tail, and a skip from the head (EDSR, Lim 2017).

    As in EDSR-baseline, without normalisation or residual scaling. Padding is by replication, since zeros are not a
    valid pose; EDSR pads images with zeros.
    """

    def __init__(self, config: EdsrConfig, numbers: int) -> None:
        super().__init__()
        features = config.features
        self.head = _convolution(numbers, features)
        self.blocks = nn.ModuleList(ResidualBlock(features) for _ in range(config.blocks))
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
