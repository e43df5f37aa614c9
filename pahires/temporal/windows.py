"""Training windows for temporal networks: observed frames and queries, drawn per task.

All are pure functions of a numpy generator. `observed` ascends from 0; `queried` are consecutive frames, so that
velocities can be compared.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch

from motionkit.core.errors import UsageError
from motionkit.core.shapes import Bool, Float32, Float64, Int64
from motionkit.data.rotation_sequences import RotationSequences
from motionkit.features import rotations
from motionkit.training.networks import VectorScaling
from pahires.temporal.base_curves import WindowFrames, measure_scaling
from pahires.temporal.network import ObservedWindow
from pahires.temporal.settings import TaskSettings, TemporalSettings

Task = Literal["interpolate", "gap", "scattered", "extend"]
TASKS: tuple[Task, ...] = ("interpolate", "gap", "scattered", "extend")


@dataclass(frozen=True, eq=False)
class Layout:
    """Frames of B windows: `observed` [B, N] and `queried` [B, Q], counted from the first observed one.

    A window spans all of them: `before` frames before the first observed one, `span` from there on.
    """

    observed: Int64[np.ndarray, "batch frames"]
    queried: Int64[np.ndarray, "batch queries"]

    @property
    def before(self) -> Int64[np.ndarray, "batch"]:
        """Frames that a window needs before its first observed one."""
        return np.asarray(np.maximum(0, -self.queried[:, 0]))

    @property
    def span(self) -> Int64[np.ndarray, "batch"]:
        """Total frames of a window."""
        return np.asarray(self.before + np.maximum(self.observed[:, -1], self.queried[:, -1]) + 1)


def draw_task(rng: np.random.Generator, settings: TaskSettings) -> Task:
    """Draw one of the four tasks by their shares."""
    shares = np.array(settings.shares)
    return TASKS[int(rng.choice(len(TASKS), p=shares / shares.sum()))]


def draw_layout(task: Task, rng: np.random.Generator, batch: int, settings: TaskSettings) -> Layout:
    """The layout of a batch of windows; all have the same numbers of observed and of queried frames."""
    return _DRAW[task](rng, batch, settings)


def kept_frames(num_frames: int, factor: Float64[np.ndarray, "batch"]) -> Int64[np.ndarray, "batch frames"]:
    """k_i = ⌊i·s + 1e-9⌋: the frames that down-sampling by s, whole or not, keeps (`factor` [B], 1 or more)."""
    return np.asarray(np.floor(np.arange(num_frames) * factor[:, None] + 1e-9), dtype=np.int64)


def _interpolate(rng: np.random.Generator, batch: int, settings: TaskSettings) -> Layout:
    # A quarter of the steps observe fewer frames, to train on ends of motions and short ones too.
    count = settings.num_frames if rng.random() < 0.75 else int(rng.integers(2, settings.num_frames + 1))
    observed = kept_frames(count, rng.uniform(settings.smallest_factor, settings.largest_factor, batch))
    return Layout(observed, _run_inside(rng, np.zeros(batch, np.int64), observed[:, -1], settings.num_queries))


def _gap(rng: np.random.Generator, batch: int, settings: TaskSettings) -> Layout:
    as_benchmark = rng.random() < 0.5
    past = settings.past_frames if as_benchmark else int(rng.integers(1, settings.past_frames + 1))
    future = 1 if as_benchmark else int(rng.integers(1, settings.future_frames + 1))
    missing = rng.integers(settings.shortest_gap, settings.longest_gap + 1, batch)
    ahead = np.broadcast_to(np.arange(past), (batch, past))
    after = past + missing[:, None] + np.arange(future)
    # The last given frame before the gap and the first after it are queried too, for a continuous transition.
    queried = _run_inside(rng, np.full(batch, past - 1), past + missing, settings.num_queries)
    return Layout(np.concatenate((ahead, after), axis=1), queried)


def _scattered(rng: np.random.Generator, batch: int, settings: TaskSettings) -> Layout:
    count = int(rng.integers(2, settings.num_frames + 1))
    span = max(count, int(np.ceil(count * rng.uniform(1.0, settings.largest_factor))))
    inner = np.argsort(rng.random((batch, span - 2)), axis=1)[:, : count - 2] + 1 if span > 2 else None
    ends = np.broadcast_to(np.array([0, span - 1]), (batch, 2))
    observed = ends if inner is None else np.sort(np.concatenate((ends, inner), axis=1), axis=1)
    return Layout(observed, _run_inside(rng, np.zeros(batch, np.int64), observed[:, -1], settings.num_queries))


def _extend(rng: np.random.Generator, batch: int, settings: TaskSettings) -> Layout:
    count = int(rng.integers(2, settings.num_frames + 1))
    observed = kept_frames(count, np.full(batch, 1.0 if rng.random() < 0.5 else settings.largest_factor))
    length = min(settings.num_queries, settings.longest_reach + 1)
    # Consecutive frames beyond an end, which may include it; every other step is reversed in time.
    away = rng.integers(0, settings.longest_reach + 2 - length, batch)[:, None] + np.arange(length)
    return Layout(observed, observed[:, -1:] + away if rng.random() < 0.5 else -away[:, ::-1])


_DRAW: dict[Task, Callable[[np.random.Generator, int, TaskSettings], Layout]] = {
    "interpolate": _interpolate,
    "gap": _gap,
    "scattered": _scattered,
    "extend": _extend,
}


def _run_inside(
    rng: np.random.Generator, first: Int64[np.ndarray, "batch"], last: Int64[np.ndarray, "batch"], longest: int
) -> Int64[np.ndarray, "batch queries"]:
    """Runs of equal length within [first, last]: of `longest` frames, or of as many as the shortest stretch has."""
    length = int(min(longest, (last - first).min() + 1))
    starts = first + rng.integers(0, last - first + 2 - length)
    return np.asarray(starts[:, None] + np.arange(length), dtype=np.int64)


DRAWS_TO_MEASURE, WINDOWS_PER_DRAW = 16, 256


@dataclass(frozen=True, eq=False)
class RawWindows:
    """World rows of B windows, with times in seconds from the first observed frame."""

    observed: Float32[np.ndarray, "batch frames numbers"]
    targets: Float32[np.ndarray, "batch queries numbers"]
    layout: Layout
    seconds_between: Float64[np.ndarray, "batch"]


@dataclass(frozen=True, eq=False)
class TrainingBatch:
    """Network inputs, and the standardised true rows at the queries."""

    window: ObservedWindow
    targets: Float32[torch.Tensor, "batch queries numbers"]
    task: Task


@dataclass(frozen=True, eq=False)
class WindowSampler:
    """Draws windows uniformly over all positions in the takes of a source.

    Sources are weighted by `source_evenness` (`TemporalSettings`).
    """

    takes: RotationSequences
    settings: TemporalSettings

    def task(self, rng: np.random.Generator) -> Task:
        """Draw the task of a batch."""
        return draw_task(rng, self.settings.tasks)

    def draw(self, rng: np.random.Generator, task: Task, batch: int) -> RawWindows:
        """Draw windows of one task, each mirrored with probability 1/2 if `mirrored`."""
        layout = draw_layout(task, rng, batch, self.settings.tasks)
        take, first = self._places(rng, layout.span)
        # At the table's framerate a window may begin at any native frame; at a finer one it takes less of the room.
        room = self.takes.keep_every[take]
        stride = rng.integers(1, room + 1) if self.settings.finer else room
        native = first * room + rng.integers(0, layout.span * (room - stride) + stride) + layout.before * stride
        frames = np.concatenate((layout.observed, layout.queried), axis=1)
        rows = self.takes.read(take, native, stride, frames)
        if self.settings.mirrored:
            flip: Bool[np.ndarray, batch] = rng.random(batch) < 0.5
            rows[flip] = rotations.mirrored(rows[flip], self.takes.skeleton)
        count = layout.observed.shape[1]
        return RawWindows(rows[:, :count], rows[:, count:], layout, self.takes.seconds_between(take, stride))

    def measure(self, rng: np.random.Generator) -> VectorScaling:
        """The scale of rows in their windows' frames, from a few thousand windows of all tasks, by their shares."""
        rows = []
        for _ in range(DRAWS_TO_MEASURE):
            raw = self.draw(rng, self.task(rng), WINDOWS_PER_DRAW)
            frames = WindowFrames.of(raw.observed, self.takes.skeleton)
            rows.append(frames.to_window(np.concatenate((raw.observed[:, ::4], raw.targets[:, ::4]), axis=1)))
        return measure_scaling(np.concatenate([each.reshape(-1, each.shape[-1]) for each in rows]))

    def batch(self, rng: np.random.Generator, scaling: VectorScaling) -> TrainingBatch:
        """A batch of one task, in the windows' frames, standardised."""
        task = self.task(rng)
        return self.standardised(self.draw(rng, task, self.settings.schedule.batch_size), task, scaling)

    def standardised(self, raw: RawWindows, task: Task, scaling: VectorScaling) -> TrainingBatch:
        """Network inputs from world rows."""
        frames = WindowFrames.of(raw.observed, self.takes.skeleton)
        step = raw.seconds_between
        window = ObservedWindow(
            frames=scaling.apply(torch.from_numpy(frames.to_window(raw.observed))),
            times_seconds=torch.from_numpy((raw.layout.observed * step[:, None]).astype(np.float32)),
            queries_seconds=torch.from_numpy((raw.layout.queried * step[:, None]).astype(np.float32)),
            query_spacing_seconds=torch.from_numpy(step.astype(np.float32)),
        )
        return TrainingBatch(window, scaling.apply(torch.from_numpy(frames.to_window(raw.targets))), task)

    def _places(
        self, rng: np.random.Generator, span: Int64[np.ndarray, "batch"]
    ) -> tuple[Int64[np.ndarray, "batch"], Int64[np.ndarray, "batch"]]:
        """A take and the window's first frame in it, uniform over those places of a source where `span` frames fit."""
        take, first = np.empty_like(span), np.empty_like(span)
        takes = self.takes
        for length in np.unique(span).tolist():
            rows = np.flatnonzero(span == length)
            places = np.maximum(0, takes.num_frames - length + 1)
            of_source = np.bincount(takes.source, weights=places)
            if not of_source.any():
                raise UsageError(
                    f"no chosen take has the {length} frames at {self.settings.fps} fps that a training window takes "
                    f"(the longest has {int(takes.num_frames.max())}): shorter gaps, fewer frames or smaller "
                    "factors (tasks.longest_gap, tasks.num_frames, tasks.largest_factor) need less"
                )
            weight = places / np.maximum(of_source, 1.0)[takes.source] ** self.settings.source_evenness
            take[rows] = rng.choice(len(weight), len(rows), p=weight / weight.sum())
            first[rows] = rng.integers(0, places[take[rows]])
        return take, first
