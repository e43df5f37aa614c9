"""What is observed of a training window and what is asked: frame numbers at the table's framerate, drawn per task.

All are pure functions of a numpy generator. `observed` ascends from 0 on; `asked` is a run of neighbouring frames, so
that velocities can be compared.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64, Int64

from pahires.settings import TaskSettings

Task = Literal["interpolate", "gap", "scattered", "extend"]
TASKS: tuple[Task, ...] = ("interpolate", "gap", "scattered", "extend")


@dataclass(frozen=True, eq=False)
class Layout:
    """Frames of B windows: `observed` [B, N] and `asked` [B, Q], counted from the first observed one.

    With `before` frames in front of it and `span` from there on a window holds all that either names.
    """

    observed: Int64[np.ndarray, "batch frames"]
    asked: Int64[np.ndarray, "batch queries"]

    @property
    def before(self) -> Int64[np.ndarray, "batch"]:
        """Frames that a window needs in front of its first observed one."""
        return np.asarray(np.maximum(0, -self.asked[:, 0]))

    @property
    def span(self) -> Int64[np.ndarray, "batch"]:
        """Frames that a window has in all."""
        return np.asarray(self.before + np.maximum(self.observed[:, -1], self.asked[:, -1]) + 1)


def draw_task(rng: np.random.Generator, settings: TaskSettings) -> Task:
    """One of the four tasks, by their shares."""
    shares = np.array(settings.shares)
    return TASKS[int(rng.choice(len(TASKS), p=shares / shares.sum()))]


def draw_layout(task: Task, rng: np.random.Generator, batch: int, settings: TaskSettings) -> Layout:
    """The layout of a batch of windows; all have the same numbers of observed and of asked frames."""
    return _DRAW[task](rng, batch, settings)


def kept_frames(num_frames: int, factor: Float64[np.ndarray, "batch"]) -> Int64[np.ndarray, "batch frames"]:
    """k_i = ⌊i·s + 1e-9⌋: the frames that down-sampling by s, whole or not, keeps (`factor` [B], 1 or more)."""
    return np.asarray(np.floor(np.arange(num_frames) * factor[:, None] + 1e-9), dtype=np.int64)


def _interpolate(rng: np.random.Generator, batch: int, settings: TaskSettings) -> Layout:
    # A quarter of the steps observe fewer frames, so that the ends of motions and short ones are known too.
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
    # The last given frame before the gap and the first after it are asked too: there the answer must join.
    asked = _run_inside(rng, np.full(batch, past - 1), past + missing, settings.num_queries)
    return Layout(np.concatenate((ahead, after), axis=1), asked)


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
    # A run on the frames beyond an end, which it may touch; every other step goes backwards in time.
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
