"""Framerates as exact fractions; seconds ↔ frames ↔ normalised coordinates in [−1, 1].

Frame k of a sequence is at `start_seconds + k / fps`. Intervals are half-open: T frames last T / fps seconds, while the
observed instants span (T − 1) / fps.
"""

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache

import numpy as np

from motionkit.core.errors import shown
from motionkit.core.shapes import Bool, Float64, Int64

# Tolerance for equal instants.
SAME_SECONDS = 1e-6
COMMON_FPS: tuple[Fraction, ...] = (
    *(Fraction(n) for n in (10, 12, 15, 16, 20, 24, 25, 30, 48, 50, 60, 72, 75, 90, 100, 120, 144, 150, 200, 240, 250)),
    *(Fraction(n) for n in (300, 360, 480, 500, 1000)),
    Fraction(25, 2),
    Fraction(24000, 1001),
    Fraction(30000, 1001),
    Fraction(60000, 1001),
    Fraction(120000, 1001),
)
SNAP_TOLERANCE = 1e-3
MIN_FPS, MAX_FPS = Fraction(1), Fraction(10_000)
LARGEST_FLOAT = 1e308
# Anything that `parse_fps` accepts.
Framerate = Fraction | int | float | str


@lru_cache(maxsize=256, typed=True)  # a corpus repeats the same few thousands of times
def parse_fps(value: Framerate) -> Fraction:
    """Read a framerate exactly: `120`, `"30000/1001"`, `"59.94"`, or a float that is snapped to a common rate.

    A float or decimal string within 0.1 % of a common framerate becomes that rate (120.00004577636719 → 120), because
    files print them with few digits; anything else becomes the closest fraction with a denominator up to 100,000.
    Raises `ValueError` for anything but a finite number between 1 and 10,000 frames per second.
    """
    if isinstance(value, str):
        try:
            value = Fraction(value) if "/" in value else float(value)
        except (ValueError, ZeroDivisionError):
            raise ValueError(f"a framerate is a number such as 120, 59.94 or 30000/1001, not {shown(value)}") from None
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ValueError(f"a framerate must be a finite number, not {value}")
        exact = Fraction(value)
        nearest = min(COMMON_FPS, key=lambda rate: abs(rate - exact))
        fps = nearest if abs(nearest - exact) <= SNAP_TOLERANCE * nearest else exact.limit_denominator(100_000)
    else:
        fps = Fraction(value)
    if not MIN_FPS <= fps <= MAX_FPS:
        found = f"{float(fps):g}" if abs(fps) < LARGEST_FLOAT else "a number of that many digits"
        raise ValueError(f"a framerate must lie between {MIN_FPS} and {MAX_FPS} frames a second, not {found}")
    return fps


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


def num_frames_within(span_seconds: float, fps: Fraction) -> int:
    """Number of frames k / fps that lie in [0, span_seconds], the end included within `SAME_SECONDS`."""
    return int(np.floor((span_seconds + SAME_SECONDS) * float(fps))) + 1


def normalise_seconds(
    seconds: Float64[np.ndarray, "*shape"], max_duration_seconds: float
) -> Float64[np.ndarray, "*shape"]:
    """Seconds since the start of a window of l_max seconds → coordinates in [−1, 1] (NeRM §3.1)."""
    return -1.0 + 2.0 * seconds / max_duration_seconds


def runs(mask: Bool[np.ndarray, "instants"]) -> tuple[Int64[np.ndarray, "runs"], Int64[np.ndarray, "runs"]]:
    """Start and stop index of every run of True in a mask."""
    changes = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return changes[::2], changes[1::2]
