"""What the command line says of how files are read."""

from pathlib import Path
from typing import TYPE_CHECKING

from motionkit.core.errors import UsageError

if TYPE_CHECKING:
    from motionkit.formats.scan.items import ReadOptions


def read_options(
    format: str, fps: str | None, unit_metres: float | None, captions: Path | None = None
) -> "ReadOptions":
    """The options of readers; raises `UsageError` for a framerate or a unit that is none."""
    from motionkit.core.timegrid import parse_fps
    from motionkit.formats.scan.items import ReadOptions

    if unit_metres is not None and not 0 < unit_metres < float("inf"):
        raise UsageError(f"--unit-metres must be a positive number, not {unit_metres}")
    try:
        rate = None if fps is None else parse_fps(fps)
    except ValueError as error:
        raise UsageError(f"--fps {fps}: {error}") from None
    return ReadOptions(format=format, fps=rate, unit_metres=unit_metres, captions=captions)
