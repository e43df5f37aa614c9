"""The peers, each with its names, the class of its network, and its recipes. Imports nothing heavy.

`nano` and `base` train as PA-HiRes' recipes of the same names (windows, batch, form of the output), each on its own
task alone: `base` for as many steps as PA-HiRes spends on it, `nano` for two thirds of them. Blended curves and
corrections scaled by the motion are PA-HiRes' alone. `paper` has each peer's published sizes, schedule and form.
`base` has the published sizes too, except that widths of 16 become 64 (docs/pahires.md) and in-betweening has half
the width. Networks of `nano` are small.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, make_dataclass, replace
from functools import cached_property, partial
from importlib import import_module
from typing import TYPE_CHECKING, Any

from motionkit.training.config import Schedule
from motionkit.training.run import Task
from pahires.temporal.settings import (
    AnswerSettings,
    TaskSettings,
    TemporalConfig,
    TemporalSettings,
    base_training,
    nano_training,
)
from peers.settings import (
    ALiifNetworkConfig,
    DeltaInterpNetworkConfig,
    EdsrConfig,
    LiifNetworkConfig,
    LmfNetworkConfig,
    MetaSrNetworkConfig,
    TsFormerNetworkConfig,
)

if TYPE_CHECKING:
    import torch


@dataclass(frozen=True)
class Peer:
    """A published method.

    `name` and `order` are its stage's, `title` names its rows in tables; `network` is "module:Class", built from sizes;
    `recipes` are the sizes of the network and the training settings, by name.
    """

    name: str
    order: int
    title: str
    description: str
    task: Task
    network: str
    recipes: Mapping[str, tuple[Any, TemporalSettings]]

    @cached_property
    def config_type(self) -> type[Any]:
        """The stage's configuration: the parts `network` and `training`."""
        sizes = type(self.recipes["paper"][0])
        parts = [
            (name, part, field(default_factory=part))
            for name, part in (("network", sizes), ("training", TemporalSettings))
        ]
        check = _check_on_grids if self.task == "interpolation" else _check
        return make_dataclass(
            sizes.__name__.replace("Network", ""), parts, frozen=True, namespace={"__post_init__": check}
        )

    @property
    def configs(self) -> dict[str, Callable[[], Any]]:
        """The recipes as functions that make their configurations."""
        make: Callable[..., Any] = self.config_type
        return {name: partial(make, *parts) for name, parts in self.recipes.items()}

    def make_network(self, config: Any, num_features: int) -> "torch.nn.Module":
        """Build the network for rows of `num_features`, initialised by torch's global generator."""
        module, _, name = self.network.partition(":")
        made: torch.nn.Module = getattr(import_module(module), name)(config.network, num_features)
        return made


def _check(config: TemporalConfig) -> None:
    """Raise `ValueError` for blended curves, whose weights no peer predicts."""
    if config.training.answer.curves:
        raise ValueError("peers predict rows only, no weights of curves: leave training.answer.blended empty")


def _check_on_grids(config: TemporalConfig) -> None:
    """As `_check`, and raise `ValueError` for tasks with unevenly spaced frames."""
    _check(config)
    if config.training.tasks.gap or config.training.tasks.scattered:
        raise ValueError(
            "this model needs evenly spaced frames: training.tasks.gap and training.tasks.scattered must be 0"
        )


# Every s-th frame observed, s ~ U(1, 4), for Tables 1 and 2; a gap in the frames for Table 3.
INTERPOLATION = TaskSettings(interpolate=1.0, gap=0.0, scattered=0.0, extend=0.0)
IN_BETWEENING = TaskSettings(interpolate=0.0, gap=1.0, scattered=0.0, extend=0.0)


def _on(task: TaskSettings, training: TemporalSettings, learning_rate: float | None = None) -> TemporalSettings:
    """The part of a training on all tasks that is on one task."""
    steps, shares = training.schedule.steps, training.tasks.shares
    assert steps is not None
    kept = sum(share for share, wanted in zip(shares, task.shares, strict=True) if wanted)
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


def _correcting_slerp(training: TemporalSettings) -> TemporalSettings:
    return replace(training, answer=replace(training.answer, form="residual", base="slerp"))


NANO, BASE = _on(INTERPOLATION, nano_training()), _on(INTERPOLATION, base_training())
BASE_GAPS = _on(IN_BETWEENING, base_training(), learning_rate=2e-4)
# The four for images: Adam at 1e-4, halved every 200 of 1,000 epochs, batches of 16 windows of 48 frames.
IMAGE_PAPER = TemporalSettings(
    tasks=replace(INTERPOLATION, num_frames=48, num_queries=48),
    schedule=Schedule(epochs=1000, batch_size=16, learning_rate=1e-4, kind="steps", warmup_fraction=0.02),
)
# 300 epochs at 2e-4, a tenth of it after 200; gaps of 5 to 39 frames.
DELTA_INTERP_PAPER = TemporalSettings(
    tasks=replace(IN_BETWEENING, longest_gap=39),
    answer=AnswerSettings(form="residual"),
    schedule=Schedule(epochs=300, learning_rate=2e-4, kind="steps", warmup_fraction=0.02, drop=0.1, drop_every=2 / 3),
)
# 2,000 epochs at the 3.1e-5 that the published schedule peaks at; gaps of 5 to 30 frames.
TS_FORMER_PAPER = TemporalSettings(
    tasks=replace(IN_BETWEENING, longest_gap=30),
    schedule=Schedule(epochs=2000, batch_size=32, learning_rate=3.1e-5, kind="cosine", warmup_fraction=0.02),
)
FAIR_WIDTH = 64
SMALL_ENCODER = EdsrConfig(blocks=4, features=64)
PEERS = (
    Peer(
        "liif",
        70,
        "LIIF",
        "LIIF over time: a local MLP around each frame (PA-HiRes' peer)",
        "interpolation",
        "peers.liif:Liif",
        {
            "nano": (LiifNetworkConfig(SMALL_ENCODER, hidden=128), NANO),
            "base": (LiifNetworkConfig(), BASE),
            "paper": (LiifNetworkConfig(), IMAGE_PAPER),
        },
    ),
    Peer(
        "meta-sr",
        71,
        "Meta-SR",
        "Meta-SR over time: predicted weights for every position between frames",
        "interpolation",
        "peers.liif:MetaSr",
        {
            "nano": (MetaSrNetworkConfig(SMALL_ENCODER, hidden=64), NANO),
            "base": (MetaSrNetworkConfig(), BASE),
            "paper": (MetaSrNetworkConfig(), IMAGE_PAPER),
        },
    ),
    Peer(
        "a-liif",
        72,
        "A-LIIF",
        "A-LIIF over time: LIIF with a mixture of MLPs at every instant",
        "interpolation",
        "peers.a_liif:ALiif",
        {
            "nano": (ALiifNetworkConfig(SMALL_ENCODER, width=FAIR_WIDTH, basis=4, expansion_hidden=64), NANO),
            "base": (ALiifNetworkConfig(width=FAIR_WIDTH), BASE),
            "paper": (ALiifNetworkConfig(), IMAGE_PAPER),
        },
    ),
    Peer(
        "lmf",
        73,
        "LMF",
        "LMF over time: frames modulate a small MLP",
        "interpolation",
        "peers.a_liif:Lmf",
        {
            # At 1e-3 the scales, multiplied through six layers, diverge: the plain form fails within 500 steps.
            "nano": (LmfNetworkConfig(SMALL_ENCODER, width=FAIR_WIDTH), _on(INTERPOLATION, nano_training(), 4e-4)),
            "base": (LmfNetworkConfig(width=FAIR_WIDTH), BASE),
            "paper": (LmfNetworkConfig(), IMAGE_PAPER),
        },
    ),
    Peer(
        "delta-interp",
        74,
        "Δ-Interp",
        "Δ-Interp: in-betweening relative to an interpolation",
        "inbetweening",
        "peers.delta_interp:DeltaInterp",
        {
            "nano": (
                DeltaInterpNetworkConfig(width=96, blocks=3, layers=2, heads=4, dropout=0.0),
                _correcting_slerp(_on(IN_BETWEENING, nano_training())),
            ),
            "base": (DeltaInterpNetworkConfig(width=512), _correcting_slerp(BASE_GAPS)),
            "paper": (DeltaInterpNetworkConfig(), DELTA_INTERP_PAPER),
        },
    ),
    Peer(
        "ts-former",
        75,
        "TS-Former",
        "TS-Former: in-betweening by a draft and its refinement",
        "inbetweening",
        "peers.ts_former:TsFormer",
        {
            "nano": (
                TsFormerNetworkConfig(width=64, layers=2, heads=2, head_width=32, inner=64),
                _on(IN_BETWEENING, nano_training()),
            ),
            "base": (TsFormerNetworkConfig(width=256, head_width=32, inner=256), BASE_GAPS),
            "paper": (TsFormerNetworkConfig(), TS_FORMER_PAPER),
        },
    ),
)
