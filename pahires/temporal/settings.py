"""Training settings of temporal networks: corpus and framerate, tasks, form of the output, optimiser."""

import dataclasses
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Literal

from motionkit.core.timegrid import parse_fps
from motionkit.training.config import Precision, Schedule, require_positive

Base = Literal["hold", "linear", "slerp", "catmull-rom", "cubic", "eased"]
# Form of a network's output: the poses; a correction to the interpolation; a correction that vanishes at observed
# frames, which are then kept exactly.
Form = Literal["plain", "residual", "exact"]
# Corrections are scaled by the time between observed frames, or also by the local change of velocity.
Sizing = Literal["gap", "motion"]
# Squared errors (the paper), or absolute errors (L1, as published for LIIF and similar).
Distance = Literal["squared", "absolute"]


@dataclass(frozen=True)
class TaskSettings:
    """Observed frames of a training window, in frames of the table's framerate.

    A step has one task, drawn by the shares. `interpolate`: `num_frames` frames, every s-th with s ~
    U(`smallest_factor`, `largest_factor`), whole or not (paper §4.1). `gap`: up to `past_frames` frames, a gap of
    `shortest_gap` to `longest_gap`, up to `future_frames` frames; every other such step has all the past and one future
    frame, as the LaFAN1 benchmark. `scattered`: random frames of a span. `extend`: frames up to `longest_reach` beyond
    either end.
    """

    interpolate: float = 1.0
    gap: float = 0.0
    scattered: float = 0.0
    extend: float = 0.0
    num_frames: int = 16
    smallest_factor: float = 1.0
    largest_factor: float = 4.0
    past_frames: int = 10
    future_frames: int = 10
    shortest_gap: int = 5
    longest_gap: int = 45
    longest_reach: int = 30
    num_queries: int = 16

    def __post_init__(self) -> None:
        if min(self.shares) < 0 or sum(self.shares) <= 0:
            raise ValueError(f"the tasks' shares must be 0 or more and not all 0, not {self.shares}")
        if not 1 <= self.smallest_factor <= self.largest_factor:
            raise ValueError(f"factors go from 1 on upwards, not from {self.smallest_factor} to {self.largest_factor}")
        if not 1 <= self.shortest_gap <= self.longest_gap:
            raise ValueError(f"gaps go from 1 frame on upwards, not from {self.shortest_gap} to {self.longest_gap}")
        for name in ("num_frames", "num_queries", "past_frames", "future_frames", "longest_reach"):
            if getattr(self, name) < 2:
                raise ValueError(f"{name} must be 2 or more, not {getattr(self, name)}")

    @property
    def shares(self) -> tuple[float, float, float, float]:
        """Shares of the four tasks, in the order of their names here."""
        return self.interpolate, self.gap, self.scattered, self.extend


@dataclass(frozen=True)
class AnswerSettings:
    """The form of a network's output (`pahires.temporal.prediction`); `scale` is that of corrections."""

    form: Form = "plain"
    base: Base = "slerp"
    blended: tuple[Base, ...] = ()
    sizing: Sizing = "gap"
    scale: float = 1.0

    def __post_init__(self) -> None:
        require_positive(self, "scale")

    @property
    def curves(self) -> tuple[Base, ...]:
        """The curves whose weights a network predicts: those `blended`, in residual forms."""
        return () if self.form == "plain" else self.blended


@dataclass(frozen=True)
class LossSettings:
    """MSE + `velocity_weight` · MSE of differences between neighbouring frames (Eq. 8 to 10, as means), or with
    `distance` absolute both of absolute errors.

    `balanced` divides each window's by that of the interpolation, so that gaps and dashes do not drown the rest, plus
    `balance_floor` of its mean over the batch, so that windows in which hardly anything moves do not count without
    bound.
    """

    distance: Distance = "squared"
    velocity_weight: float = 0.5
    balanced: bool = False
    balance_floor: float = 1.0

    def __post_init__(self) -> None:
        for name in ("velocity_weight", "balance_floor"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name} must be 0 or more, not {getattr(self, name)}")


@dataclass(frozen=True)
class TemporalSettings:
    """Training of a temporal network, the same for all of them.

    `fps`: the table's framerate; of a take at k·fps every k-th frame is used, from a random one of the first k on, and
    takes of other framerates are left out. With `finer` a window of such a take has one of the framerates from `fps` up
    to its own, so that what lies between the table's frames is learnt where it was captured. A source's share of the
    windows grows with its frames to the power 1 − `source_evenness`: 0 takes every frame as often as another, 1 every
    source. `layout` is `smpl22`, or `native` for a corpus of one skeleton. In an epoch every second of the corpus is
    the start of a window once. Weights are averaged with a decay of `ema_decay`; 0 keeps the last ones.
    """

    where: str = "split = 'train'"
    fps: str = "30"
    finer: bool = False
    source_evenness: float = 0.0
    layout: Literal["smpl22", "native"] = "smpl22"
    mirrored: bool = True
    tasks: TaskSettings = dataclasses.field(default_factory=TaskSettings)
    answer: AnswerSettings = dataclasses.field(default_factory=AnswerSettings)
    loss: LossSettings = dataclasses.field(default_factory=LossSettings)
    schedule: Schedule = dataclasses.field(
        default_factory=lambda: Schedule(steps=2000, learning_rate=1e-3, kind="cosine", warmup_fraction=0.02)
    )
    ema_decay: float = 0.0
    precision: Precision = "float32"

    def __post_init__(self) -> None:
        if not 0 <= self.source_evenness <= 1:
            raise ValueError(f"source_evenness must lie in [0, 1], not {self.source_evenness}")
        if not 0 <= self.ema_decay < 1:
            raise ValueError(f"ema_decay must lie in [0, 1), not {self.ema_decay}")
        parse_fps(self.fps)

    @property
    def framerate(self) -> Fraction:
        """The table's framerate, exactly."""
        return parse_fps(self.fps)


# All tasks of completion: more frames, gaps filled, frames here and there, the ends continued.
ALL_TASKS = TaskSettings(interpolate=0.45, gap=0.35, scattered=0.1, extend=0.1)


def nano_training() -> TemporalSettings:
    """A quarter of an hour on a CPU core: all tasks, as corrections to an interpolation that keep given frames."""
    return TemporalSettings(
        finer=True,
        # Of two sources of which one has nine times the other's frames, three of four windows and not nine of ten.
        source_evenness=0.5,
        tasks=ALL_TASKS,
        answer=AnswerSettings(form="exact", base="eased"),
        loss=LossSettings(balanced=True),
        schedule=Schedule(steps=8_000, learning_rate=1e-3, kind="cosine", warmup_fraction=0.02),
        ema_decay=0.995,
    )


def base_training() -> TemporalSettings:
    """An hour on an H100: `nano_training` with longer windows, larger batches and more steps."""
    nano = nano_training()
    return dataclasses.replace(
        nano,
        tasks=dataclasses.replace(ALL_TASKS, num_frames=32, num_queries=32),
        schedule=dataclasses.replace(nano.schedule, steps=60_000, batch_size=512, learning_rate=4e-4),
        ema_decay=0.999,
        precision="auto",
    )


@dataclass(frozen=True)
class TemporalConfig:
    """A model's configuration; the part `network` is the model's own."""

    network: Any = None
    training: TemporalSettings = dataclasses.field(default_factory=TemporalSettings)
