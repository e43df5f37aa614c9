"""Random poses at native framerates with their coordinates, as torch batches.

A window is a stretch of at most l_max seconds of one sequence: what one latent stands for. Its frame k lies at k / fps
after its first, at the coordinate t = −1 + 2·(k / fps) / l_max (NeRM §3.1), and its poses are vectors in the window's
own frame (`field` vectors, or what a `FrameVectors` makes of frames). Poses are read from the cache's file when they
are asked for, so memory doesn't grow with the corpus; mirrored windows are mirrored then, not stored.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Bool, Float32, Float64, Int, Int64

from motionkit.errors import UsageError
from motionkit.features import field
from motionkit.store.row_file import RowFile
from motionkit.timegrid import normalise_seconds


@runtime_checkable
class PositionSource(Protocol):
    """What clips need from `motionkit.store.cache.PositionCache`."""

    @property
    def positions(self) -> Float32[np.ndarray, "total_frames joints 3"]:
        """Positions of all sequences, one after the other, metres."""
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


@runtime_checkable
class ReadsRows(Protocol):
    """A source whose frames can be read one by one, so that a training does not come to hold all that it has seen."""

    @property
    def rows(self) -> RowFile:
        """The rows of `positions`."""
        ...


def read_positions(source: PositionSource, row: Int64[np.ndarray, "*rows"]) -> Float32[np.ndarray, "*rows joints 3"]:
    """Copies of a source's frames by their rows."""
    return source.rows[row] if isinstance(source, ReadsRows) else np.asarray(source.positions[row])


@dataclass(frozen=True, eq=False)
class Windows:
    """W windows of a corpus, as arrays.

    `sequence_index` leads back to the store, `start_row` into the cache's positions; `start_frame` counts from the
    sequence's first frame. `yaw` (radians) and `origin` (x, z in metres) are the window's frame, of the mirrored pose
    where `mirrored`.
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

    @property
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
        return {name: value for name, value in vars(self).items() if isinstance(value, np.ndarray)}

    def select(self, rows: Int[np.ndarray, "chosen"] | Bool[np.ndarray, "windows"]) -> "Windows":
        """Some of the windows."""
        return Windows(self.max_duration_seconds, **{name: array[rows] for name, array in self.arrays().items()})

    def __repr__(self) -> str:
        hours = float(self.duration_seconds.sum()) / 3600
        return f"Windows({len(self)} of at most {self.max_duration_seconds:g} s, {hours:.2f} h)"


@dataclass(frozen=True, eq=False)
class PoseBatch:
    """Poses of some windows at some of their instants.

    `coordinates` t ∈ [−1, 1] stay float64 until a network reads them; `fps` is the rate s at which the poses were
    taken; `vectors` are pose vectors in their own units (`field` vectors: metres).
    """

    window: Int64[torch.Tensor, "batch"]
    coordinates: Float64[torch.Tensor, "batch poses"]
    fps: Float64[torch.Tensor, "batch"]
    vectors: Float32[torch.Tensor, "batch poses numbers"]

    def to(self, device: torch.device) -> "PoseBatch":
        """The batch on another device."""
        return PoseBatch(*(tensor.to(device) for tensor in (self.window, self.coordinates, self.fps, self.vectors)))


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
    last one that ends with it. Sequences shorter than `min_duration_seconds` are left out. With `mirror_pairs` (the
    skeleton's left and right joints) every window is followed, W rows later, by its mirror image. Raises `UsageError`
    where nothing is left.
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
    first_pose = read_positions(source, start_row)
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


def mirror_positions(
    joint_positions: Float32[np.ndarray, "*poses joints 3"], left_right_pairs: tuple[tuple[int, int], ...]
) -> Float32[np.ndarray, "*poses joints 3"]:
    """The mirror image: x ← −x with left and right joints exchanged (HumanML3D, raw_pose_processing.ipynb)."""
    order = np.arange(joint_positions.shape[-2])
    for left, right in left_right_pairs:
        order[left], order[right] = right, left
    return joint_positions[..., order, :] * np.array([-1.0, 1.0, 1.0], dtype=np.float32)


@runtime_checkable
class FrameVectors(Protocol):
    """How frames of a source become pose vectors: gathered by row, interpolated between rows, put into a window.

    What is gathered may be any array with a row per frame; rows are those of the source's positions.
    """

    def gather(
        self, row: Int64[np.ndarray, "batch poses"], mirrored: Bool[np.ndarray, "batch"]
    ) -> Float32[np.ndarray, "batch poses *shape"]:
        """The numbers of frames, mirrored where the window is; the caller may write to them."""
        ...

    def between(
        self,
        before: Float32[np.ndarray, "batch poses *shape"],
        after: Float32[np.ndarray, "batch poses *shape"],
        weight: Float32[np.ndarray, "batch poses"],
    ) -> Float32[np.ndarray, "batch poses *shape"]:
        """Numbers between two frames."""
        ...

    def encode(
        self,
        gathered: Float32[np.ndarray, "batch poses *shape"],
        yaw: Float32[np.ndarray, "batch"],
        origin: Float32[np.ndarray, "batch 2"],
    ) -> Float32[np.ndarray, "batch poses numbers"]:
        """Pose vectors in the windows' frames."""
        ...


@dataclass(frozen=True, eq=False)
class FramePositions:
    """`field` vectors, from positions as the source has them."""

    source: PositionSource
    left_right_pairs: tuple[tuple[int, int], ...]

    def gather(
        self, row: Int64[np.ndarray, "batch poses"], mirrored: Bool[np.ndarray, "batch"]
    ) -> Float32[np.ndarray, "batch poses joints 3"]:
        """World positions, mirrored where the window is."""
        gathered = read_positions(self.source, row)
        if mirrored.any():
            gathered[mirrored] = mirror_positions(gathered[mirrored], self.left_right_pairs)
        return gathered

    def between(
        self,
        before: Float32[np.ndarray, "batch poses joints 3"],
        after: Float32[np.ndarray, "batch poses joints 3"],
        weight: Float32[np.ndarray, "batch poses"],
    ) -> Float32[np.ndarray, "batch poses joints 3"]:
        """On straight lines."""
        return np.asarray(before + weight[..., None, None] * (after - before))

    def encode(
        self,
        gathered: Float32[np.ndarray, "batch poses joints 3"],
        yaw: Float32[np.ndarray, "batch"],
        origin: Float32[np.ndarray, "batch 2"],
    ) -> Float32[np.ndarray, "batch poses numbers"]:
        """Root path in the window's frame, joints relative to the root."""
        return field.encode(gathered, yaw, origin)


@dataclass(frozen=True, eq=False)
class WindowPoses:
    """Poses of windows, gathered from their source: the one place where frames become pose vectors.

    With `fixed_fps` poses are taken at that framerate only, instead of at the native ones. `frames` says what vectors
    they become (default: `field` vectors of the source's positions).
    """

    source: PositionSource
    windows: Windows
    left_right_pairs: tuple[tuple[int, int], ...]
    fixed_fps: Fraction | None = None
    frames: FrameVectors | None = None

    def positions(
        self, window: Int64[np.ndarray, "batch"], frame: Int64[np.ndarray, "batch poses"]
    ) -> Float32[np.ndarray, "batch poses joints 3"]:
        """World positions at native frames (counted from each window's first), mirrored where the window is."""
        row = self.windows.start_row[window][:, None] + frame
        return FramePositions(self.source, self.left_right_pairs).gather(row, self.windows.mirrored[window])

    def at_frames(
        self,
        window: Int64[np.ndarray, "batch"],
        frame: Int64[np.ndarray, "batch poses"],
        keep_every: Int64[np.ndarray, "batch"] | None = None,
    ) -> PoseBatch:
        """A batch of poses at native frames; with `keep_every` at frames of what keeping every n-th frame leaves."""
        fps = self.windows.fps[window]
        if keep_every is not None:
            fps, frame = fps / keep_every, frame * keep_every[:, None]
        return self._batch(window, frame / self.windows.fps[window][:, None], fps, self._gathered(window, frame))

    def at_rate(
        self, window: Int64[np.ndarray, "batch"], tick: Int64[np.ndarray, "batch poses"], fps: Fraction
    ) -> PoseBatch:
        """A batch of poses at tick / fps seconds; between native frames they are interpolated (positions linearly)."""
        numerator = self.windows.fps_numerator[window][:, None] * fps.denominator
        denominator = self.windows.fps_denominator[window][:, None] * fps.numerator
        before, remainder = np.divmod(tick * numerator, denominator)
        after = np.minimum(before + 1, self.windows.num_frames[window][:, None] - 1)
        gathered = self._gathered(window, before)
        weight = (remainder / denominator).astype(np.float32)
        if weight.any():
            gathered = self._frames.between(gathered, self._gathered(window, after), weight)
        return self._batch(window, tick / float(fps), np.full(len(window), float(fps)), gathered)

    def draw(
        self,
        window: Int64[torch.Tensor, "batch"],
        num_poses: int,
        generator: torch.Generator,
        *,
        contiguous: bool,
        fps: Fraction | None = None,
        lowest_fps: float | None = None,
        part: Int64[torch.Tensor, "part"] | None = None,
    ) -> PoseBatch:
        """`num_poses` random poses of each window, at its native framerate or at `fps` (default: `fixed_fps`).

        `contiguous`: a clip of m neighbouring poses around a random centre v (NeRM §3.1), in a window with fewer poses
        than m its last pose is repeated; else m independent instants. With `lowest_fps` each window's rate is its
        native one or a random whole fraction of it that isn't lower ("random framerates", the paper's Fig. 2). With
        `part` all is drawn alike, but only these rows of the batch are gathered.
        """
        rows, fps = window.numpy(), fps or self.fixed_fps
        keep_every = np.ones(len(rows), dtype=np.int64)
        if fps is not None:
            available = self._last_tick(rows, fps) + 1
        else:
            if lowest_fps is not None:
                choices = np.maximum(1.0, np.floor(self.windows.fps[rows] / lowest_fps + 1e-6))
                drawn = torch.rand(len(rows), generator=generator, dtype=torch.float64).numpy()
                keep_every += np.floor(drawn * choices).astype(np.int64)
            available = (self.windows.num_frames[rows] - 1) // keep_every + 1
        if contiguous:
            uniform = torch.rand(len(rows), 1, generator=generator, dtype=torch.float64).numpy()
            first = np.floor(uniform * np.maximum(1, available - num_poses + 1)[:, None]).astype(np.int64)
            chosen = np.minimum(first + np.arange(num_poses), available[:, None] - 1)
        else:
            uniform = torch.rand(len(rows), num_poses, generator=generator, dtype=torch.float64).numpy()
            chosen = np.floor(uniform * available[:, None]).astype(np.int64)
        if part is not None:
            rows, chosen, keep_every = (each[part.numpy()] for each in (rows, chosen, keep_every))
        return self.at_frames(rows, chosen, keep_every) if fps is None else self.at_rate(rows, chosen, fps)

    def evenly(self, window: Int64[np.ndarray, "batch"], num_poses: int) -> PoseBatch:
        """`num_poses` poses, native or at `fixed_fps`, spread evenly over each window, its first and last included."""
        spread = np.linspace(0.0, 1.0, num_poses)
        if self.fixed_fps is not None:
            last = self._last_tick(window, self.fixed_fps)[:, None]
            return self.at_rate(window, np.round(spread * last).astype(np.int64), self.fixed_fps)
        last = self.windows.num_frames[window][:, None] - 1
        return self.at_frames(window, np.round(spread * last).astype(np.int64))

    def _last_tick(self, window: Int64[np.ndarray, "batch"], fps: Fraction) -> Int64[np.ndarray, "batch"]:
        """The last k for which k / fps seconds lie inside each window."""
        rate = self.windows.fps[window] / float(fps)
        return np.asarray(np.floor((self.windows.num_frames[window] - 1) / rate + 1e-6), dtype=np.int64)

    @property
    def _frames(self) -> FrameVectors:
        return self.frames or FramePositions(self.source, self.left_right_pairs)

    def _gathered(
        self, window: Int64[np.ndarray, "batch"], frame: Int64[np.ndarray, "batch poses"]
    ) -> Float32[np.ndarray, "batch poses *shape"]:
        return self._frames.gather(self.windows.start_row[window][:, None] + frame, self.windows.mirrored[window])

    def _batch(
        self,
        window: Int64[np.ndarray, "batch"],
        seconds: Float64[np.ndarray, "batch poses"],
        fps: Float64[np.ndarray, "batch"],
        gathered: Float32[np.ndarray, "batch poses *shape"],
    ) -> PoseBatch:
        vectors = self._frames.encode(gathered, self.windows.yaw[window], self.windows.origin[window])
        return PoseBatch(
            window=torch.from_numpy(window),
            coordinates=torch.from_numpy(normalise_seconds(seconds, self.windows.max_duration_seconds)),
            fps=torch.from_numpy(np.ascontiguousarray(fps)),
            vectors=torch.from_numpy(vectors),
        )


def rows_by_duration(windows: Windows, seconds_per_visit: float) -> Int64[np.ndarray, "visits"]:
    """Each window as often as it lasts `seconds_per_visit`, once at least: what an epoch goes through."""
    visits = np.maximum(1, np.round(windows.duration_seconds / seconds_per_visit)).astype(np.int64)
    return np.repeat(np.arange(len(windows)), visits)


def shuffled_batches(count: int, batch: int, step: int, seed: int) -> Int64[torch.Tensor, "batch"]:
    """The rows of batch number `step`, when `count` rows are gone through again and again in a new order each time.

    A function of (seed, step) alone, so that a resumed training sees the same batches.
    """
    first = step * batch
    epochs = range(first // count, (first + batch - 1) // count + 1)
    rows = torch.cat([_permutation(count, seed, epoch) for epoch in epochs])
    offset = first - epochs[0] * count
    return rows[offset : offset + batch]


def _permutation(count: int, seed: int, epoch: int) -> Int64[torch.Tensor, "rows"]:
    order = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(epoch,))).permutation(count)
    return torch.from_numpy(order.astype(np.int64))


def chunks(count: int, size: int) -> Iterator[Int64[np.ndarray, "rows"]]:
    """Rows 0 … count − 1 in chunks of at most `size`."""
    for start in range(0, count, size):
        yield np.arange(start, min(start + size, count), dtype=np.int64)
