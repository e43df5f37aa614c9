"""Seconds ↔ frames ↔ normalised coordinates in [−1, 1]; clip windows.

Frame k of a sequence is at `start_seconds + k / fps`. Intervals are half-open: T frames last T / fps seconds, while the
observed instants span (T − 1) / fps.
"""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from motionkit.core.shapes import Float64

# Tolerance for equal instants.
SAME_SECONDS = 1e-6


@dataclass(frozen=True)
class TimeGrid:
    """The instants of a uniformly sampled sequence: `num_frames` frames at `fps`, the first at `start_seconds`.

    >>> mk.TimeGrid(Fraction(20), 3, start_seconds=1.0).seconds()
    array([1.  , 1.05, 1.1 ])
    """

    fps: Fraction
    num_frames: int
    start_seconds: float = 0.0

    def __post_init__(self) -> None:
        if self.num_frames < 1:
            raise ValueError(f"a time grid needs at least one frame, not {self.num_frames}")
        if self.fps <= 0:
            raise ValueError(f"fps must be positive, not {self.fps}")

    @property
    def seconds_between_frames(self) -> float:
        """1 / fps."""
        return float(1 / self.fps)

    @property
    def duration_seconds(self) -> float:
        """Length of the half-open interval that the frames cover: num_frames / fps."""
        return float(self.num_frames / self.fps)

    @property
    def span_seconds(self) -> float:
        """Time between the first and the last frame: (num_frames − 1) / fps."""
        return float((self.num_frames - 1) / self.fps)

    def seconds(self) -> Float64[np.ndarray, "frames"]:
        """Time stamps of all frames in seconds; frame k times one second exactly, then one rounding."""
        frames = np.arange(self.num_frames, dtype=np.float64)
        return self.start_seconds + frames * self.fps.denominator / self.fps.numerator

    def normalised(self, max_duration_seconds: float) -> Float64[np.ndarray, "frames"]:
        """Coordinates t = −1 + 2·seconds / l_max of all frames, from the start of the sequence (NeRM §3.1)."""
        return normalise_seconds(self.seconds() - self.start_seconds, max_duration_seconds)


def normalise_seconds(
    seconds: Float64[np.ndarray, "*shape"], max_duration_seconds: float
) -> Float64[np.ndarray, "*shape"]:
    """Seconds since the start of a window of l_max seconds → coordinates in [−1, 1]."""
    return -1.0 + 2.0 * seconds / max_duration_seconds


def num_frames_within(span_seconds: float, fps: Fraction) -> int:
    """Number of frames k / fps that lie in [0, span_seconds], the end included within `SAME_SECONDS`."""
    return int(np.floor((span_seconds + SAME_SECONDS) * float(fps))) + 1
