"""The project's errors: each states the place, what was found and what was expected."""

from os import PathLike
from pathlib import Path


class MotionkitError(Exception):
    """An error with a message for users; the command line prints it as one line and exits with 1."""


def describe(error: Exception) -> str:
    """An error's message for users; for system errors the file and the reason, without error numbers."""
    if not isinstance(error, OSError) or not error.strerror:
        return str(error)
    names = [str(name) for name in (error.filename, error.filename2) if isinstance(name, (str, PathLike))]
    return ": ".join((" to ".join(names), error.strerror)) if names else error.strerror


class FormatError(MotionkitError):
    """A file that cannot be read as a motion.

    `reason` is a short fixed slug (`truncated`, `channel-count`, `nan`, `frame-time` …) by which ingest counts;
    `line` (1-based) and `frame` (0-based) are positions if known.
    """

    def __init__(
        self, message: str, *, path: Path | str, reason: str, line: int | None = None, frame: int | None = None
    ) -> None:
        self.path = path if isinstance(path, Path) else Path(path)
        self.reason = reason
        self.line = line
        self.frame = frame
        self.message = message
        where = str(path)
        if line is not None:
            where += f", line {line}"
        if frame is not None:
            where += f", frame {frame}"
        super().__init__(f"{where}: {message}")

    def __reduce__(self) -> tuple[object, ...]:
        return _rebuild_format_error, (self.message, str(self.path), self.reason, self.line, self.frame)


def _rebuild_format_error(message: str, path: str, reason: str, line: int | None, frame: int | None) -> FormatError:
    return FormatError(message, path=path, reason=reason, line=line, frame=frame)


class DamagedFileError(MotionkitError):
    """A damaged file; `hint` tells the user how to repair it."""

    def __init__(self, path: Path | str, fault: str, hint: str) -> None:
        super().__init__(f"{path} is damaged ({fault}): {hint}")
        self.path = Path(path)
        self.fault = fault
        self.hint = hint

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (str(self.path), self.fault, self.hint)


class MotionkitWarning(UserWarning):
    """A warning about a result; the command line prints it as one line."""


class BusyError(MotionkitError):
    """A folder that another process is writing."""


class StoreError(MotionkitError):
    """A store that is missing, damaged, or of another format version."""


class UsageError(MotionkitError):
    """An invalid request; the command line exits with 2."""


class MissingExtraError(MotionkitError):
    """An optional dependency that is not installed."""

    def __init__(self, package: str, extra: str) -> None:
        super().__init__(f"this needs the package {package!r}: in a checkout of motionkit, pip install '.[{extra}]'")
