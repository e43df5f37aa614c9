"""Which framerate is used and what is said of it; time stamps of frames → a uniform grid, or an explained refusal."""

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from motionkit.core.errors import FormatError
from motionkit.core.framerate import parse_fps
from motionkit.core.timegrid import TimeGrid

# Milliseconds, rounded, are off by 0.06 of a frame at 120 fps; a frame that is missing is off by 1.
UNEVEN_FRAMES = 0.1


def fps_in_use(
    given: Fraction | None, stated: Callable[[], Fraction], *, words: str = ""
) -> tuple[Fraction, list[str]]:
    """The framerate that is given, else the one that is stated; and what `replaced_fps` logs of it.

    `stated` reads what the file states. A `FormatError` that it raises is one where nothing is given; else the file
    says `words`, or none.
    """
    if given is None:
        return stated(), []
    try:
        said: Fraction | str = stated()
    except FormatError:
        said = words
    return given, replaced_fps(given, said)


def replaced_fps(fps: Fraction, stated: Fraction | str | None, *, by: str = "", who: str = "the file") -> list[str]:
    """The log line of a framerate that is used where `who` states another one or none; no line where both are the same.

    `by` names what decided.
    """
    return [] if fps == stated else [f"framerate set to {fps}{by}; {who} says {stated or 'none'}"]


def grid_of_seconds(seconds: Float64[np.ndarray, "frames"], path: Path, fps: Fraction | None = None) -> TimeGrid:
    """The grid of evenly spaced time stamps in seconds; `fps` is what else says the framerate, and must agree.

    Raises `FormatError` (`no-framerate` for one time stamp alone, `frame-time` for uneven ones).
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
    # A frame that is missing shifts the mean of all steps; their median says where it is.
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
