"""Windows of a corpus: at most l_max seconds of one sequence each.

A window's frame k is k / fps after its first, at the coordinate t = −1 + 2·(k / fps) / l_max (NeRM §3.1). Positions
are read lazily from the cache's file, so memory doesn't grow with the corpus; mirroring is done then too.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields
from fractions import Fraction
from functools import cached_property, lru_cache
from typing import Protocol, runtime_checkable

import numpy as np

from motionkit.core.errors import UsageError
from motionkit.core.mirror import mirror_positions
from motionkit.core.shapes import Bool, Float32, Float64, Int, Int64
from motionkit.features import field


@runtime_checkable
class PositionSource(Protocol):
    """The interface of `motionkit.store.cache.PositionCache` that windows are cut from."""

    @property
    def positions(self) -> Float32[np.ndarray, "total_frames joints 3"]:
        """Concatenated positions of all sequences, metres."""
        ...

    @property
    def sequence_index(self) -> Int[np.ndarray, "sequences"]:
        """Each sequence's index in the store."""
        ...

    @property
    def start_row(self) -> Int[np.ndarray, "sequences"]:
        """First row of each sequence in `positions`."""
        ...

    @property
    def num_frames(self) -> Int[np.ndarray, "sequences"]:
        """Frames of each sequence."""
        ...

    @property
    def fps_numerator(self) -> Int[np.ndarray, "sequences"]:
        """Numerator of each sequence's framerate."""
        ...

    @property
    def fps_denominator(self) -> Int[np.ndarray, "sequences"]:
        """Denominator of each sequence's framerate."""
        ...


@dataclass(frozen=True, eq=False)
class Windows:
    """W windows of a corpus, as arrays.

    `sequence_index` refers to the store, `start_row` to the cache's positions; `start_frame` counts from the sequence's
    first frame. `yaw` (radians) and `origin` (x, z in metres) are the window's coordinate frame, after mirroring if
    `mirrored`.
    """

    max_duration_seconds: float
    sequence_index: Int64[np.ndarray, "windows"]
    start_row: Int64[np.ndarray, "windows"]
    start_frame: Int64[np.ndarray, "windows"]
    num_frames: Int64[np.ndarray, "windows"]
    fps_numerator: Int64[np.ndarray, "windows"]
    fps_denominator: Int64[np.ndarray, "windows"]
    mirrored: Bool[np.ndarray, "windows"]
    yaw: Float32[np.ndarray, "windows"]
    origin: Float32[np.ndarray, "windows 2"]

    def __len__(self) -> int:
        return len(self.sequence_index)

    @cached_property
    def fps(self) -> Float64[np.ndarray, "windows"]:
        """Native framerates."""
        return np.asarray(self.fps_numerator / self.fps_denominator)

    @property
    def start_seconds(self) -> Float64[np.ndarray, "windows"]:
        """Time of each window's first frame in its sequence."""
        return np.asarray(self.start_frame / self.fps)

    @property
    def duration_seconds(self) -> Float64[np.ndarray, "windows"]:
        """Time from each window's first frame to its last: (num_frames − 1) / fps, at most l_max."""
        return np.asarray((self.num_frames - 1) / self.fps)

    def exact_fps(self, window: int) -> Fraction:
        """One window's framerate as a fraction."""
        return Fraction(int(self.fps_numerator[window]), int(self.fps_denominator[window]))

    def arrays(self) -> dict[str, np.ndarray]:
        """The arrays by name, as they are saved."""
        return {each.name: getattr(self, each.name) for each in fields(self) if each.name != "max_duration_seconds"}

    def select(self, rows: Int[np.ndarray, "chosen"] | Bool[np.ndarray, "windows"]) -> "Windows":
        """Some of the windows."""
        return Windows(self.max_duration_seconds, **{name: array[rows] for name, array in self.arrays().items()})

    def __repr__(self) -> str:
        hours = float(self.duration_seconds.sum()) / 3600
        return f"Windows({len(self)} of at most {self.max_duration_seconds:g} s, {hours:.2f} h)"


def cut_windows(
    source: PositionSource,
    *,
    max_duration_seconds: float,
    stride_seconds: float | None = None,
    min_duration_seconds: float = 0.5,
    mirror_pairs: tuple[tuple[int, int], ...] | None = None,
) -> Windows:
    """Cut every sequence into windows of at most `max_duration_seconds`.

    A sequence that fits is one window. A longer one gives full windows every `stride_seconds` (l_max by default) and a
    last one aligned with its end. Sequences shorter than `min_duration_seconds` are dropped. With `mirror_pairs` (the
    skeleton's left and right joints) mirrored copies of all W windows are appended. Raises `UsageError` if there are no
    windows.
    """
    stride = max_duration_seconds if stride_seconds is None else stride_seconds
    if stride <= 0 or max_duration_seconds <= 0:
        raise UsageError("a window's longest duration and the stride between windows must be positive")
    fps = source.fps_numerator / source.fps_denominator
    frames = source.num_frames.astype(np.int64)
    longest = np.floor(max_duration_seconds * fps + 1e-6).astype(np.int64) + 1
    step = np.maximum(1, np.round(stride * fps).astype(np.int64))
    spare = np.maximum(0, frames - longest)
    count = np.where((frames - 1) / fps < min_duration_seconds, 0, 1 + -(-spare // step))
    if not count.any():
        raise UsageError(f"no sequence lasts {min_duration_seconds:g} s; nothing to cut windows from")
    sequence = np.repeat(np.arange(len(frames)), count)
    nth = np.arange(len(sequence)) - np.repeat(np.cumsum(count) - count, count)
    start = np.minimum(nth * step[sequence], spare[sequence])
    start_row = source.start_row[sequence].astype(np.int64) + start
    first_pose = source.positions[start_row]
    mirrored = np.zeros(len(sequence), dtype=np.bool_)
    if mirror_pairs is not None:
        first_pose = np.concatenate((first_pose, mirror_positions(first_pose, mirror_pairs)))
        mirrored = np.concatenate((mirrored, ~mirrored))
        sequence, start, start_row = (np.concatenate((each, each)) for each in (sequence, start, start_row))
    yaw, origin = field.window_frame(first_pose)
    return Windows(
        max_duration_seconds,
        sequence_index=source.sequence_index[sequence].astype(np.int64),
        start_row=start_row,
        start_frame=start,
        num_frames=np.minimum(longest, frames)[sequence],
        fps_numerator=source.fps_numerator[sequence].astype(np.int64),
        fps_denominator=source.fps_denominator[sequence].astype(np.int64),
        mirrored=mirrored,
        yaw=yaw,
        origin=origin,
    )


def rows_by_duration(windows: Windows, seconds_per_visit: float) -> Int64[np.ndarray, "visits"]:
    """The windows of an epoch: each once per `seconds_per_visit` of its duration, at least once."""
    visits = np.maximum(1, np.round(windows.duration_seconds / seconds_per_visit)).astype(np.int64)
    return np.repeat(np.arange(len(windows)), visits)


def shuffled_batches(count: int, batch: int, step: int, seed: int) -> Int64[np.ndarray, "batch"]:
    """The rows of batch number `step` in epochs over `count` rows, reshuffled each time.

    A function of (seed, step) alone, so that resumed training sees the same batches.
    """
    first, last = step * batch, (step + 1) * batch
    rows = [
        _permutation(count, seed, epoch)[max(0, first - epoch * count) : last - epoch * count]
        for epoch in range(first // count, (last - 1) // count + 1)
    ]
    return np.concatenate(rows)


# Two, since a batch may begin in one epoch and end in the next.
@lru_cache(maxsize=2)
def _permutation(count: int, seed: int, epoch: int) -> Int64[np.ndarray, "rows"]:
    order = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(epoch,))).permutation(count)
    return order.astype(np.int64)


def chunks(count: int, size: int) -> Iterator[Int64[np.ndarray, "rows"]]:
    """Rows 0 … count − 1 in chunks of at most `size`."""
    for start in range(0, count, size):
        yield np.arange(start, min(start + size, count), dtype=np.int64)
