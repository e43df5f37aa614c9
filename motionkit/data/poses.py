"""Poses of windows at native framerates with their coordinates, as torch batches: random clips, frames, ticks."""

from dataclasses import dataclass
from fractions import Fraction
from typing import Protocol, runtime_checkable

import numpy as np
import torch

from motionkit.core.mirror import mirror_positions
from motionkit.core.shapes import Bool, Float32, Float64, Int64
from motionkit.core.timegrid import normalise_seconds
from motionkit.data.windows import PositionSource, Windows, read_positions
from motionkit.features import field


@runtime_checkable
class FrameVectors(Protocol):
    """Conversion of a source's frames to pose vectors: gather rows, interpolate, convert to a window's frame.

    Gathered values may be any array with a row per frame; rows are those of the source's positions.
    """

    def gather(
        self, row: Int64[np.ndarray, "batch poses"], mirrored: Bool[np.ndarray, "batch"]
    ) -> Float32[np.ndarray, "batch poses *shape"]:
        """The values of frames, mirrored for mirrored windows; the caller may modify them."""
        ...

    def between(
        self,
        before: Float32[np.ndarray, "batch poses *shape"],
        after: Float32[np.ndarray, "batch poses *shape"],
        weight: Float32[np.ndarray, "batch poses"],
    ) -> Float32[np.ndarray, "batch poses *shape"]:
        """Interpolate between two frames."""
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
        """Move to a device."""
        return PoseBatch(*(tensor.to(device) for tensor in (self.window, self.coordinates, self.fps, self.vectors)))


@dataclass(frozen=True, eq=False)
class WindowPoses:
    """Poses of windows, gathered from their source and converted to pose vectors.

    With `fixed_fps` poses are sampled at that framerate instead of the native ones. `frames` is the conversion to
    vectors (default: `field` vectors of the source's positions).
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
        """A batch of poses at native frames; with `keep_every`, at frames of the sequence of every n-th frame."""
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

        `contiguous`: a clip of m neighbouring poses around a random centre v (NeRM §3.1), with the last pose
        repeated in windows of fewer poses; else m independent instants. With `lowest_fps` each window's rate is
        its native one or a random integer fraction of it that isn't lower ("random framerates", the paper's
        Fig. 2). With `part` the random draws are the same, but only these rows of the batch are gathered.
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
