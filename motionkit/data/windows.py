"""Windows of a corpus, at most l_max seconds of one sequence each, and their poses in batches.

A window's frame k is k / fps after its first, at the coordinate t = −1 + 2·(k / fps) / l_max (NeRM §3.1). Frames are
read lazily from the cache's files, so memory doesn't grow with the corpus; mirroring is done then too.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from fractions import Fraction
from functools import cached_property, lru_cache

import numpy as np

from motionkit.core.errors import UsageError
from motionkit.core.motion import mirror_positions
from motionkit.core.shapes import Bool, Float32, Float64, Int, Int64
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.timegrid import normalise_seconds
from motionkit.features import field, native
from motionkit.features.convention import PoseVectors, PoseVectorsName
from motionkit.features.field import FIELD_VECTORS
from motionkit.features.native import NativeVectors
from motionkit.features.rotations import RotationVectors, begins_as_smpl, mean_rig
from motionkit.store.cache import PositionCache, open_cache
from motionkit.store.reader import Store, conjunction


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
    source: PositionCache,
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


NATIVE_ROWS = "native-vectors-1"


@dataclass(frozen=True, eq=False)
class FrameValues:
    """What `vectors` keeps of each frame of a corpus: a row for each row of its cache's positions."""

    rows: Float32[np.ndarray, "total_frames *values"]
    vectors: PoseVectors

    def gather(
        self, row: Int64[np.ndarray, "batch poses"], mirrored: Bool[np.ndarray, "batch"]
    ) -> Float32[np.ndarray, "batch poses *row"]:
        """Copies of the values of frames, mirrored for mirrored windows."""
        values: Float32[np.ndarray, "batch poses *row"] = self.rows[row]
        if mirrored.any():
            values[mirrored] = self.vectors.mirror(values[mirrored])
        return values


def training_vectors(name: PoseVectorsName, store: Store, where: str | None) -> PoseVectors:
    """The convention for training on these sequences of a store; raises `UsageError` as `open_frames` does."""
    if name == "field":
        return FIELD_VECTORS
    return NativeVectors() if name == "native" else RotationVectors(training_rig(store, where))


def open_frames(vectors: PoseVectors, store: Store, where: str | None) -> tuple[PositionCache, FrameValues]:
    """The sequences that match `where` and support these vectors, and the values of their frames.

    Values other than positions are computed once, from whole sequences, and kept beside the cache. Raises `UsageError`
    if there are no such sequences.
    """
    if isinstance(vectors, RotationVectors):
        joints = vectors.skeleton.num_joints
        cache = open_cache(store, layout=SMPL22.name, where=with_rotations(store, where, joints))
        motions = (motion for motion in store.read_many(cache.sequence_index.tolist()))
        rows = cache.derived_rows(f"rotations-{joints}-1", 3 + 4 * joints, lambda: map(vectors.values, motions))
        return cache, FrameValues(rows, vectors)
    cache = open_cache(store, layout=SMPL22.name, where=where)
    if isinstance(vectors, NativeVectors):
        rows = cache.derived_rows(NATIVE_ROWS, vectors.num_features, lambda: _native_vectors(cache))
        return cache, FrameValues(rows, vectors)
    return cache, FrameValues(cache.positions, vectors)


def _native_vectors(cache: PositionCache) -> Iterator[Float32[np.ndarray, "frames features"]]:
    for sequence in range(cache.num_sequences):
        positions = np.asarray(cache.sequence_positions(sequence))
        if len(positions) < 2:
            yield np.zeros((len(positions), NativeVectors().num_features), np.float32)
        else:
            yield native.vectors(positions, SMPL22.name, cache.exact_fps(sequence))


def with_rotations(store: Store, where: str | None, num_joints: int = SMPL22.num_joints) -> str:
    """The condition for sequences with rotations of SMPL's first joints among those for which `where` holds.

    Raises `UsageError` where there are none.
    """
    known = [name for name, skeleton in store.skeletons.items() if begins_as_smpl(skeleton, num_joints)]
    listed = ", ".join(f"'{fingerprint}'" for fingerprint in sorted(known)) or "''"
    condition = conjunction(where, f"has_rotations AND skeleton IN ({listed})")
    if not len(store.select(condition)):
        among = f" among those with {where}" if where else ""
        raise UsageError(
            f"pose_vectors=rotations needs sequences with the joint rotations of SMPL's {num_joints} joints "
            f"(AMASS, UESTC); {store.path} has none{among}: ingest some, or train on positions "
            "(pose_vectors=field)"
        )
    return condition


def training_rig(store: Store, where: str | None) -> Skeleton:
    """The skeleton that poses are decoded on: the mean of the chosen sequences' bodies (`mean_rig`).

    Raises `UsageError` where there are none, or where rest poses differ.
    """
    chosen = store.select(with_rotations(store, where))
    return mean_rig([store.skeletons[name] for name in sorted(set(store.columns("skeleton")["skeleton"].loc[chosen]))])


Batch = Int64[np.ndarray, "batch"]
BatchPoses = Int64[np.ndarray, "batch poses"]

Uniform = Callable[..., np.ndarray]


@dataclass(frozen=True, eq=False)
class PoseBatch:
    """Poses of some windows at some of their instants.

    `coordinates` t ∈ [−1, 1] stay float64 until a network reads them; `fps` is the rate s at which the poses were
    taken; `vectors` are pose vectors in their own units (`field` vectors: metres).
    """

    window: Batch
    coordinates: Float64[np.ndarray, "batch poses"]
    fps: Float64[np.ndarray, "batch"]
    vectors: Float32[np.ndarray, "batch poses features"]


@dataclass(frozen=True, eq=False)
class WindowPoses:
    """Poses of windows, gathered from the values of a corpus' frames and converted to pose vectors.

    With `fixed_fps` poses are sampled at that framerate instead of the native ones.
    """

    windows: Windows
    frames: FrameValues
    fixed_fps: Fraction | None = None

    def at_frames(self, window: Batch, frame: BatchPoses, keep_every: Batch | None = None) -> PoseBatch:
        """A batch of poses at native frames; with `keep_every`, at frames of the sequence of every n-th frame."""
        fps = self.windows.fps[window]
        if keep_every is not None:
            fps, frame = fps / keep_every, frame * keep_every[:, None]
        return self._batch(window, frame / self.windows.fps[window][:, None], fps, self._gathered(window, frame))

    def at_rate(self, window: Batch, tick: BatchPoses, fps: Fraction) -> PoseBatch:
        """A batch of poses at tick / fps seconds; between native frames they are interpolated (positions linearly)."""
        numerator = self.windows.fps_numerator[window][:, None] * fps.denominator
        denominator = self.windows.fps_denominator[window][:, None] * fps.numerator
        before, remainder = np.divmod(tick * numerator, denominator)
        after = np.minimum(before + 1, self.windows.num_frames[window][:, None] - 1)
        gathered = self._gathered(window, before)
        weight = (remainder / denominator).astype(np.float32)
        if weight.any():
            gathered = self.frames.vectors.between(gathered, self._gathered(window, after), weight)
        return self._batch(window, tick / float(fps), np.full(len(window), float(fps)), gathered)

    def draw(
        self,
        window: Batch,
        num_poses: int,
        uniform: Uniform,
        *,
        contiguous: bool,
        fps: Fraction | None = None,
        lowest_fps: float | None = None,
        rows: Int64[np.ndarray, "rows"] | None = None,
    ) -> PoseBatch:
        """`num_poses` random poses of each window, at its native framerate or at `fps` (default: `fixed_fps`).

        `uniform(*shape)` draws numbers in [0, 1). `contiguous`: m neighbouring poses around a random centre v (NeRM
        §3.1), with the last pose repeated in windows of fewer poses; else m independent instants. With `lowest_fps`
        each window's rate is its native one or a random integer fraction of it that isn't lower ("random framerates",
        the paper's Fig. 2). With `rows` the random draws are the same, but only these rows of the batch are gathered.
        """
        fps = fps or self.fixed_fps
        keep_every = np.ones(len(window), dtype=np.int64)
        if fps is not None:
            available = self._last_tick(window, fps) + 1
        else:
            if lowest_fps is not None:
                choices = np.maximum(1.0, np.floor(self.windows.fps[window] / lowest_fps + 1e-6))
                keep_every += np.floor(uniform(len(window)) * choices).astype(np.int64)
            available = (self.windows.num_frames[window] - 1) // keep_every + 1
        if contiguous:
            most = np.maximum(1, available - num_poses + 1)[:, None]
            first = np.floor(uniform(len(window), 1) * most).astype(np.int64)
            chosen = np.minimum(first + np.arange(num_poses), available[:, None] - 1)
        else:
            chosen = np.floor(uniform(len(window), num_poses) * available[:, None]).astype(np.int64)
        if rows is not None:
            window, chosen, keep_every = window[rows], chosen[rows], keep_every[rows]
        return self.at_frames(window, chosen, keep_every) if fps is None else self.at_rate(window, chosen, fps)

    def evenly(self, window: Batch, num_poses: int) -> PoseBatch:
        """`num_poses` poses, native or at `fixed_fps`, spread evenly over each window, its first and last included."""
        spread = np.linspace(0.0, 1.0, num_poses)
        if self.fixed_fps is not None:
            last = self._last_tick(window, self.fixed_fps)[:, None]
            return self.at_rate(window, np.round(spread * last).astype(np.int64), self.fixed_fps)
        last = self.windows.num_frames[window][:, None] - 1
        return self.at_frames(window, np.round(spread * last).astype(np.int64))

    def _last_tick(self, window: Batch, fps: Fraction) -> Batch:
        """The last k for which k / fps seconds lie inside each window."""
        rate = self.windows.fps[window] / float(fps)
        return np.asarray(np.floor((self.windows.num_frames[window] - 1) / rate + 1e-6), dtype=np.int64)

    def _gathered(self, window: Batch, frame: BatchPoses) -> Float32[np.ndarray, "batch poses *row"]:
        return self.frames.gather(self.windows.start_row[window][:, None] + frame, self.windows.mirrored[window])

    def _batch(
        self,
        window: Batch,
        seconds: Float64[np.ndarray, "batch poses"],
        fps: Float64[np.ndarray, "batch"],
        gathered: Float32[np.ndarray, "batch poses *row"],
    ) -> PoseBatch:
        coordinates = normalise_seconds(seconds, self.windows.max_duration_seconds)
        vectors = self.frames.vectors.encode(gathered, self.windows.yaw[window], self.windows.origin[window])
        return PoseBatch(window, coordinates, np.ascontiguousarray(fps), vectors)
