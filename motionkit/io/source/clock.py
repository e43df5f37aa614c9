"""The framerate in use and its log lines; time stamps of frames → a uniform grid, or an error that explains why not."""

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np

from motionkit.core.errors import FormatError
from motionkit.core.framerate import parse_fps
from motionkit.core.shapes import Float64
from motionkit.core.timegrid import TimeGrid

# Rounding to milliseconds is an error of 0.06 frames at 120 fps; a missing frame is one of 1.
UNEVEN_FRAMES = 0.1


def fps_in_use(
    given: Fraction | None, stated: Callable[[], Fraction], *, words: str = ""
) -> tuple[Fraction, list[str]]:
    """The given framerate, else the stated one; and the log lines of `replaced_fps`.

    `stated` reads the file's framerate. If it raises `FormatError`, that is raised only without a given framerate;
    otherwise the log names `words` as the file's statement, or none.
    """
    if given is None:
        return stated(), []
    try:
        said: Fraction | str = stated()
    except FormatError:
        said = words
    return given, replaced_fps(given, said)


def replaced_fps(fps: Fraction, stated: Fraction | str | None, *, by: str = "", who: str = "the file") -> list[str]:
    """The log line of a framerate that replaces the one that `who` states, if any; empty if both are the same.

    `by` names the source of the decision.
    """
    return [] if fps == stated else [f"framerate set to {fps}{by}; {who} says {stated or 'none'}"]


def grid_of_seconds(seconds: Float64[np.ndarray, "frames"], path: Path, fps: Fraction | None = None) -> TimeGrid:
    """The grid of evenly spaced time stamps in seconds; `fps`, if given, must agree.

    Raises `FormatError` (`no-framerate` for a single time stamp, `frame-time` for uneven ones).
    """
    finite = np.isfinite(seconds)
    if not finite.all():
        raise _fault("a time stamp is no number", path, int(np.argmin(finite)))
    if fps is None:
        fps = _framerate(seconds, path)
    grid = TimeGrid(fps, len(seconds), float(seconds[0]))
    off = np.abs(grid.seconds() - seconds) * float(fps)
    if off.max() > UNEVEN_FRAMES:
        raise _uneven(seconds, fps, path, int(np.argmax(off > UNEVEN_FRAMES)))
    return grid


def _uneven(seconds: Float64[np.ndarray, "frames"], fps: Fraction, path: Path, frame: int) -> FormatError:
    # A missing frame shifts the mean of all steps; their median locates it.
    steps = np.diff(seconds)
    usual = float(np.median(steps))
    odd = np.abs(steps - usual) > np.abs(usual) / 2
    if not odd.any():
        what = f"is at {seconds[frame]:.6g} s; time stamps are not those of {float(fps):.6g} fps"
    else:
        frame = int(np.argmax(odd)) + 1
        what = f"comes {steps[frame - 1]:.6g} s after the one before, where {usual:.6g} s is usual"
    return _fault(f"{what}; sample the motion evenly, nothing is resampled at ingest", path, frame)


def _framerate(seconds: Float64[np.ndarray, "frames"], path: Path) -> Fraction:
    if len(seconds) < 2:
        message = "one time stamp does not say a framerate; state fps, or use --fps"
        raise FormatError(message, path=path, reason="no-framerate")
    step = float(seconds[-1] - seconds[0]) / (len(seconds) - 1)
    if step <= 0:
        raise _fault("time stamps do not ascend", path, 0)
    try:
        return parse_fps(1 / step)
    except ValueError as error:
        raise _fault(str(error), path, 0) from None


def _fault(message: str, path: Path, frame: int) -> FormatError:
    return FormatError(message, path=path, reason="frame-time", frame=frame)
