"""Poses of windows at native framerates with their coordinates, in batches: consecutive frames, instants, ticks."""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from motionkit.core.shapes import Float32, Float64, Int64
from motionkit.core.timegrid import normalise_seconds
from motionkit.data.corpus import FrameValues
from motionkit.data.windows import Windows

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
