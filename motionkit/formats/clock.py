"""Time stamps of frames → a uniform time grid, or an explained refusal."""

from fractions import Fraction
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from motionkit.errors import FormatError
from motionkit.timegrid import TimeGrid, parse_fps

# Milliseconds, rounded, are off by 0.06 of a frame at 120 fps; a frame that is missing is off by 1.
UNEVEN_FRAMES = 0.1


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
        frame = int(np.argmax(off > UNEVEN_FRAMES))
        raise _fault(
            f"{seconds[frame]:.6g} s where {grid.seconds()[frame]:.6g} s was expected: time stamps are not those of "
            f"{float(fps):.6g} fps; sample the motion evenly, nothing is resampled at ingest",
            path,
            frame,
        )
    return grid


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
