"""Requests to complete clips: framerate, frames to keep, seconds beyond both ends; and their form for one clip."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

import numpy as np

from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.framerate import format_fps
from motionkit.core.plain_text import shown, whole_number
from motionkit.core.shapes import Bool, Float64
from motionkit.core.timegrid import TimeGrid

# More than a minute of extrapolation is probably a typo.
LONGEST_REACH_SECONDS = 60.0
_RANGE = re.compile(r"(?P<start>\d*)(?P<colon>:?)(?P<stop>\d*)")


@dataclass(frozen=True)
class FrameRange:
    """Frames [start, stop) of a clip; `stop` None means to its end."""

    start: int
    stop: int | None

    def __str__(self) -> str:
        return f"{self.start}:{'' if self.stop is None else self.stop}"


@dataclass(frozen=True)
class Reach:
    """Extrapolation beyond an end: seconds, or frames of the clip's own framerate."""

    amount: float
    in_frames: bool = False

    def seconds(self, fps: Fraction) -> float:
        """The extrapolation in seconds at a clip's framerate."""
        return float(self.amount / fps) if self.in_frames else self.amount


@dataclass(frozen=True)
class CompletionRequest:
    """What to complete: `fps` None is the clip's own, an empty `keep` keeps every valid frame.

    `plant` removes foot sliding from new frames.
    """

    fps: Fraction | None = None
    keep: tuple[FrameRange, ...] = ()
    before: Reach = Reach(0.0)
    after: Reach = Reach(0.0)
    plant: bool = False

    def __post_init__(self) -> None:
        if self.fps is None and not (self.keep or self.before.amount or self.after.amount or self.plant):
            raise UsageError(
                "nothing to complete: give fps (120), the frames to keep (0:10,40:50), or the seconds to extend it by "
                "(0.5,1)"
            )

    def for_clip(
        self,
        timegrid: TimeGrid,
        seen: Bool[np.ndarray, "frames"],
        uneven_seconds: Float64[np.ndarray, "frames"] | None = None,
    ) -> "ClipRequest":
        """The request for one clip with frames on `timegrid`, of which `seen` masks the valid ones.

        Raises `MotionkitError` for impossible requests: a lower framerate, frames that the clip does not have.
        """
        fps = timegrid.fps if self.fps is None else self.fps
        if uneven_seconds is not None and self.fps is None:
            raise MotionkitError(
                f"its frames are uneven in time, about {float(fps):.4g} a second: give the fps of the result"
            )
        if fps < timegrid.fps:
            raise MotionkitError(
                f"{format_fps(fps)} fps is less than its {format_fps(timegrid.fps)}: frames would be dropped, not "
                f"made; filter it down instead: motion.resample({format_fps(fps)}) in Python, or motionkit ingest and "
                f"motionkit export --fps {format_fps(fps)}"
            )
        observed = seen & kept_frames(self.keep, timegrid.num_frames)
        if not observed.any():
            raise MotionkitError("none of the frames to keep is valid: their numbers are nan")
        before, after = self.before.seconds(timegrid.fps), self.after.seconds(timegrid.fps)
        if timegrid.num_frames == 1 and not (before or after):
            raise MotionkitError("it has a single frame, so there is nothing between frames; it can only be extended")
        for reach in (before, after):
            if reach > LONGEST_REACH_SECONDS:
                raise MotionkitError(f"it can be extended by at most {LONGEST_REACH_SECONDS:g} s, not {reach:g} s")
        seconds = timegrid.seconds() if uneven_seconds is None else uneven_seconds
        known = seconds[observed]
        gap = float(np.diff(known).max()) if len(known) > 1 else 0.0
        return ClipRequest(fps, observed, before, after, gap, self.plant)


@dataclass(frozen=True, eq=False)
class ClipRequest:
    """A request for one clip: the framerate, a mask of known frames, seconds beyond both ends.

    `longest_gap_seconds` is the longest time between two known frames.
    """

    fps: Fraction
    observed: Bool[np.ndarray, "frames"]
    before_seconds: float
    after_seconds: float
    longest_gap_seconds: float
    plant: bool = False


def kept_frames(ranges: Sequence[FrameRange], num_frames: int) -> Bool[np.ndarray, "frames"]:
    """A mask of the frames to keep, all without ranges; raises `MotionkitError` for a range outside the clip."""
    kept = np.full(num_frames, not ranges)
    for each in ranges:
        stop = num_frames if each.stop is None else each.stop
        if not each.start < stop <= num_frames:
            raise MotionkitError(f"keep {each} does not lie inside its {num_frames} frames, 0:{num_frames}")
        kept[each.start : stop] = True
    return kept


def parse_keep(text: str) -> tuple[FrameRange, ...]:
    """Parse ranges of frames such as `0:10,40:50`, half-open and counted from 0; also `:10`, `40:` and a single `7`.

    Raises `UsageError` for anything else, and for empty, reversed or overlapping ranges.
    """
    found = []
    for part in text.split(","):
        match = _RANGE.fullmatch(part.strip())
        if match is None or not (match["start"] or match["colon"]):
            raise UsageError(f"keep {text}: {part.strip()!r} is not a range of frames such as 0:10, 40: or 7")
        start, end = (whole_number(match[which] or "0") for which in ("start", "stop"))
        if start is None or end is None:
            raise UsageError(f"keep {shown(text)}: no clip has as many frames")
        stop = (end if match["stop"] else None) if match["colon"] else start + 1
        if stop is not None and stop <= start:
            raise UsageError(f"keep {text}: {part.strip()} holds no frame; it ends before its second number")
        found.append(FrameRange(start, stop))
    found.sort(key=lambda each: each.start)
    for first, second in pairwise(found):
        if first.stop is None or first.stop > second.start:
            raise UsageError(f"keep {text}: {first} and {second} overlap")
    return tuple(found)


def parse_extend(text: str) -> tuple[Reach, Reach]:
    """Parse the extrapolation before and after, `0.5,1`; a single number is after. Seconds, or frames: `0,15f`.

    Raises `UsageError`.
    """
    parts = [_reach(part.strip(), text) for part in text.split(",")]
    if len(parts) > 2:
        raise UsageError(f"extend {text}: expected BEFORE,AFTER, not {len(parts)} numbers")
    return (Reach(0.0), parts[0]) if len(parts) == 1 else (parts[0], parts[1])


def _reach(part: str, text: str) -> Reach:
    number = part.removesuffix("f")
    try:
        amount = float(number)
    except ValueError:
        amount = math.nan
    if not 0 <= amount < math.inf or (part != number and amount % 1):
        raise UsageError(f"extend {text}: {part!r} is neither seconds (0.5) nor a whole number of frames (15f)")
    return Reach(amount, part != number)
