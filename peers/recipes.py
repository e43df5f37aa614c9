"""Settings of the peers and their recipes; imports nothing heavy.

`nano` and `base` train as PA-HiRes' recipes of these names do (windows, batch, form of the answer), each on its
own task alone; `base` as many steps as PA-HiRes spends on it, `nano` two thirds of them. Weights of curves, and
corrections sized by the motion, are PA-HiRes's alone. `paper` has each peer's published sizes, schedule and form.
`base` has the published sizes too, but for widths of 16, which both make 64 (docs/pahires.md), and in-betweening for
half the width. Networks of `nano` are small.
"""

from dataclasses import dataclass, field, replace
from typing import TypeVar

from motionkit.clips.temporal.settings import (
    AnswerSettings,
    TaskSettings,
    TemporalSettings,
    base_training,
    nano_training,
)
from motionkit.training.config import Schedule
from peers.settings import (
    ALiifNetworkConfig,
    DeltaInterpNetworkConfig,
    EdsrConfig,
    LiifNetworkConfig,
    LmfNetworkConfig,
    MetaSrNetworkConfig,
    TsFormerNetworkConfig,
)

FAIR_WIDTH = 64
MODULATED_RATE = 4e-4
NANO_ENCODER = EdsrConfig(blocks=4, features=64)


def _on_grids(training: TemporalSettings) -> None:
    """Raise `ValueError` for tasks whose frames lie at no even times."""
    if training.tasks.gap or training.tasks.scattered:
        raise ValueError(
            "this model needs frames at even times: training.tasks.gap and training.tasks.scattered must be 0"
        )


@dataclass(frozen=True)
class LiifConfig:
    """The stage `liif`."""

    network: LiifNetworkConfig = field(default_factory=LiifNetworkConfig)
    training: TemporalSettings = field(default_factory=TemporalSettings)

    def __post_init__(self) -> None:
        _on_grids(self.training)


@dataclass(frozen=True)
class MetaSrConfig:
    """The stage `meta-sr`."""

    network: MetaSrNetworkConfig = field(default_factory=MetaSrNetworkConfig)
    training: TemporalSettings = field(default_factory=TemporalSettings)

    def __post_init__(self) -> None:
        _on_grids(self.training)


@dataclass(frozen=True)
class ALiifConfig:
    """The stage `a-liif`."""

    network: ALiifNetworkConfig = field(default_factory=ALiifNetworkConfig)
    training: TemporalSettings = field(default_factory=TemporalSettings)

    def __post_init__(self) -> None:
        _on_grids(self.training)


@dataclass(frozen=True)
class LmfConfig:
    """The stage `lmf`."""

    network: LmfNetworkConfig = field(default_factory=LmfNetworkConfig)
    training: TemporalSettings = field(default_factory=TemporalSettings)

    def __post_init__(self) -> None:
        _on_grids(self.training)


@dataclass(frozen=True)
class DeltaInterpConfig:
    """The stage `delta-interp`."""

    network: DeltaInterpNetworkConfig = field(default_factory=DeltaInterpNetworkConfig)
    training: TemporalSettings = field(default_factory=TemporalSettings)


@dataclass(frozen=True)
class TsFormerConfig:
    """The stage `ts-former`."""

    network: TsFormerNetworkConfig = field(default_factory=TsFormerNetworkConfig)
    training: TemporalSettings = field(default_factory=TemporalSettings)


PeerConfig = LiifConfig | MetaSrConfig | ALiifConfig | LmfConfig | DeltaInterpConfig | TsFormerConfig
PeerConfigT = TypeVar(
    "PeerConfigT", LiifConfig, MetaSrConfig, ALiifConfig, LmfConfig, DeltaInterpConfig, TsFormerConfig
)

# Every s-th frame observed, s ~ U(1, 4): what Tables 1 and 2 ask. A gap in the frames: what Table 3 asks.
INTERPOLATION = TaskSettings(interpolate=1.0, gap=0.0, scattered=0.0, extend=0.0)
IN_BETWEENING = TaskSettings(interpolate=0.0, gap=1.0, scattered=0.0, extend=0.0)


def _on(task: TaskSettings, training: TemporalSettings) -> TemporalSettings:
    """Those steps of a training of all tasks that are of one task."""
    assert training.schedule.steps is not None
    kept = sum(share for share, wanted in zip(training.tasks.shares, task.shares, strict=True) if wanted)
    interpolate, gap, scattered, extend = task.shares
    return replace(
        training,
        tasks=replace(training.tasks, interpolate=interpolate, gap=gap, scattered=scattered, extend=extend),
        schedule=replace(training.schedule, steps=round(training.schedule.steps * kept / sum(training.tasks.shares))),
    )


def _at_rate(training: TemporalSettings, learning_rate: float) -> TemporalSettings:
    return replace(training, schedule=replace(training.schedule, learning_rate=learning_rate))


def _correcting_slerp(training: TemporalSettings) -> TemporalSettings:
    return replace(training, answer=replace(training.answer, form="residual", base="slerp"))


def _nano(task: TaskSettings) -> TemporalSettings:
    return _on(task, nano_training())


def _base(task: TaskSettings) -> TemporalSettings:
    return _on(task, base_training())


def _image_paper() -> TemporalSettings:
    """What all four published: Adam at 1e-4, halved every 200 of 1,000 epochs, batches of 16 windows of 48 frames."""
    return TemporalSettings(
        tasks=replace(INTERPOLATION, num_frames=48, num_queries=48),
        schedule=Schedule(epochs=1000, batch_size=16, learning_rate=1e-4, kind="steps", warmup_fraction=0.02),
    )


def liif_nano() -> LiifConfig:
    """A small network, minutes on one core."""
    return LiifConfig(LiifNetworkConfig(NANO_ENCODER, hidden=128), _nano(INTERPOLATION))


def liif_base() -> LiifConfig:
    """The published network, an hour on a GPU."""
    return LiifConfig(training=_base(INTERPOLATION))


def liif_paper() -> LiifConfig:
    """Network and schedule as published."""
    return LiifConfig(training=_image_paper())


def meta_sr_nano() -> MetaSrConfig:
    """A small network, minutes on one core."""
    return MetaSrConfig(MetaSrNetworkConfig(NANO_ENCODER, hidden=64), _nano(INTERPOLATION))


def meta_sr_base() -> MetaSrConfig:
    """The published network, an hour on a GPU."""
    return MetaSrConfig(training=_base(INTERPOLATION))


def meta_sr_paper() -> MetaSrConfig:
    """Network and schedule as published."""
    return MetaSrConfig(training=_image_paper())


def a_liif_nano() -> ALiifConfig:
    """A small network, 64 wide, minutes on one core."""
    network = ALiifNetworkConfig(NANO_ENCODER, width=FAIR_WIDTH, basis=4, expansion_hidden=64)
    return ALiifConfig(network, _nano(INTERPOLATION))


def a_liif_base() -> ALiifConfig:
    """64 wide, an hour on a GPU."""
    return ALiifConfig(ALiifNetworkConfig(width=FAIR_WIDTH), _base(INTERPOLATION))


def a_liif_paper() -> ALiifConfig:
    """Network and schedule as published, 16 wide."""
    return ALiifConfig(training=_image_paper())


def lmf_nano() -> LmfConfig:
    """A small network, 64 wide, minutes on one core."""
    # At 1e-3 scales that multiply through six layers run away: the plain form is lost within 500 steps.
    training = _at_rate(_nano(INTERPOLATION), MODULATED_RATE)
    return LmfConfig(LmfNetworkConfig(NANO_ENCODER, width=FAIR_WIDTH), training)


def lmf_base() -> LmfConfig:
    """64 wide, an hour on a GPU."""
    return LmfConfig(LmfNetworkConfig(width=FAIR_WIDTH), _base(INTERPOLATION))


def lmf_paper() -> LmfConfig:
    """Network and schedule as published, 16 wide."""
    return LmfConfig(training=_image_paper())


def delta_interp_nano() -> DeltaInterpConfig:
    """A small network, minutes on one core."""
    network = DeltaInterpNetworkConfig(width=96, blocks=3, layers=2, heads=4, dropout=0.0)
    return DeltaInterpConfig(network, _correcting_slerp(_nano(IN_BETWEENING)))


def delta_interp_base() -> DeltaInterpConfig:
    """Half the published width, an hour on a GPU."""
    training = _correcting_slerp(_at_rate(_base(IN_BETWEENING), 2e-4))
    return DeltaInterpConfig(DeltaInterpNetworkConfig(width=512), training)


def delta_interp_paper() -> DeltaInterpConfig:
    """Network as published; 300 epochs at 2e-4, a tenth of it after 200; gaps of 5 to 39 frames."""
    training = TemporalSettings(
        tasks=replace(IN_BETWEENING, longest_gap=39),
        answer=AnswerSettings(form="residual"),
        schedule=Schedule(
            epochs=300, learning_rate=2e-4, kind="steps", warmup_fraction=0.02, drop=0.1, drop_every=2 / 3
        ),
    )
    return DeltaInterpConfig(training=training)


def ts_former_nano() -> TsFormerConfig:
    """A small network, minutes on one core."""
    network = TsFormerNetworkConfig(width=64, layers=2, heads=2, head_width=32, inner=64)
    return TsFormerConfig(network, _nano(IN_BETWEENING))


def ts_former_base() -> TsFormerConfig:
    """Half the published width, an hour on a GPU."""
    training = _at_rate(_base(IN_BETWEENING), 2e-4)
    return TsFormerConfig(TsFormerNetworkConfig(width=256, head_width=32, inner=256), training)


def ts_former_paper() -> TsFormerConfig:
    """Network as published; 2,000 epochs at the 3.1e-5 that the published schedule peaks at; gaps of 5 to 30 frames."""
    training = TemporalSettings(
        tasks=replace(IN_BETWEENING, longest_gap=30),
        schedule=Schedule(epochs=2000, batch_size=32, learning_rate=3.1e-5, kind="cosine", warmup_fraction=0.02),
    )
    return TsFormerConfig(training=training)


LIIF_RECIPES = {"nano": liif_nano, "base": liif_base, "paper": liif_paper}
META_SR_RECIPES = {"nano": meta_sr_nano, "base": meta_sr_base, "paper": meta_sr_paper}
A_LIIF_RECIPES = {"nano": a_liif_nano, "base": a_liif_base, "paper": a_liif_paper}
LMF_RECIPES = {"nano": lmf_nano, "base": lmf_base, "paper": lmf_paper}
DELTA_INTERP_RECIPES = {"nano": delta_interp_nano, "base": delta_interp_base, "paper": delta_interp_paper}
TS_FORMER_RECIPES = {"nano": ts_former_nano, "base": ts_former_base, "paper": ts_former_paper}
