"""Training windows: what is observed of real frames at the table's framerate, and the exact answer at the queries."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float32, Float64, Int64

from motionkit.errors import UsageError
from motionkit.features import rotation_rows
from pahires.corpus import Takes
from pahires.network import ObservedWindow
from pahires.scaling import Scaling, WindowFrames, measure_scaling
from pahires.settings import TemporalSettings
from pahires.tasks import Layout, Task, draw_layout, draw_task

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
    """Windows as a network sees them, and the standardised rows that were really there."""

    window: ObservedWindow
    targets: Float32[torch.Tensor, "batch queries numbers"]
    task: Task


@dataclass(frozen=True, eq=False)
class WindowSampler:
    """Draws windows from all places of all takes: those of one source are as likely as another.

    Of which source a window is, `source_evenness` says (`TemporalSettings`).
    """

    takes: Takes
    settings: TemporalSettings

    def task(self, rng: np.random.Generator) -> Task:
        """The task of a batch."""
        return draw_task(rng, self.settings.tasks)

    def draw(self, rng: np.random.Generator, task: Task, batch: int) -> RawWindows:
        """So many windows of one task, mirrored one in two where `mirrored`."""
        layout = draw_layout(task, rng, batch, self.settings.tasks)
        take, first = self._places(rng, layout.span)
        # At the table's framerate a window may begin at any native frame; at a finer one it takes less of the room.
        room = self.takes.keep_every[take]
        stride = rng.integers(1, room + 1) if self.settings.finer else room
        native = first * room + rng.integers(0, layout.span * (room - stride) + stride) + layout.before * stride
        frames = np.concatenate((layout.observed, layout.asked), axis=1)
        rows = self.takes.read(take, native, stride, frames)
        if self.settings.mirrored:
            flip: Bool[np.ndarray, batch] = rng.random(batch) < 0.5
            rows[flip] = rotation_rows.mirrored(rows[flip], self.takes.skeleton)
        count = layout.observed.shape[1]
        return RawWindows(rows[:, :count], rows[:, count:], layout, self.takes.seconds_between(take, stride))

    def measure(self, rng: np.random.Generator) -> Scaling:
        """The scale of rows in their windows' frames, from a few thousand windows of all tasks, by their shares."""
        found = []
        for _ in range(DRAWS_TO_MEASURE):
            raw = self.draw(rng, self.task(rng), WINDOWS_PER_DRAW)
            frames = WindowFrames.of(raw.observed, self.takes.skeleton)
            found.append(frames.enter(np.concatenate((raw.observed[:, ::4], raw.targets[:, ::4]), axis=1)))
        return measure_scaling(np.concatenate([rows.reshape(-1, rows.shape[-1]) for rows in found]))

    def batch(self, rng: np.random.Generator, scaling: Scaling) -> TrainingBatch:
        """A batch of one task, in the windows' frames, standardised."""
        task = self.task(rng)
        return self.standardised(self.draw(rng, task, self.settings.batch), task, scaling)

    def standardised(self, raw: RawWindows, task: Task, scaling: Scaling) -> TrainingBatch:
        """World rows as a network sees them."""
        frames = WindowFrames.of(raw.observed, self.takes.skeleton)
        step = raw.seconds_between
        window = ObservedWindow(
            frames=scaling.apply(torch.from_numpy(frames.enter(raw.observed))),
            times_seconds=torch.from_numpy((raw.layout.observed * step[:, None]).astype(np.float32)),
            queries_seconds=torch.from_numpy((raw.layout.asked * step[:, None]).astype(np.float32)),
            query_spacing_seconds=torch.from_numpy(step.astype(np.float32)),
        )
        return TrainingBatch(window, scaling.apply(torch.from_numpy(frames.enter(raw.targets))), task)

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
