"""The project's errors, each with the place, what is there and what was expected; and how they show untrusted text."""

import re
import reprlib
from collections.abc import Iterable
from functools import partial
from os import PathLike
from pathlib import Path

SHOWN_LETTERS = 80
# C0 and C1 controls, direction marks and overrides, line separators, zero-width characters, lone surrogates.
UNSAFE_LETTERS = re.compile("[\x00-\x1f\x7f-\x9f\u061c\u200b\u200e\u200f\u2028-\u202e\u2060-\u2069\ufeff\ud800-\udfff]")


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
        # By its text alone, as other exceptions are copied to another process, it would lose its place.
        same = partial(FormatError, path=str(self.path), reason=self.reason, line=self.line, frame=self.frame)
        return same, (self.message,)


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


def shown(value: object, limit: int = SHOWN_LETTERS) -> str:
    """A value for a message: its `repr`, cut to `limit` letters and some items."""
    short = reprlib.Repr()
    short.maxstring = short.maxlong = short.maxother = limit
    try:
        text = short.repr(value)
    except ValueError:
        text = "a number of thousands of digits"
    return text if len(text) <= limit else f"{text[:limit]}…"


def suggestion(word: str, known: Iterable[str]) -> str:
    """` (did you mean fps?)` if a word is close to a known one, or begins with one; else empty."""
    import difflib

    plain, words = word.strip().casefold(), sorted(known)
    begun = [each for each in words if each == plain or (len(each) > 2 and plain.startswith(each))]
    near = begun or difflib.get_close_matches(plain, words, 1)
    return f" (did you mean {near[0]}?)" if near else ""


def counted(number: int, noun: str) -> str:
    """A number and its noun: "1 sequence", "1,204 sequences"."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def lasting(seconds: float) -> str:
    """A duration in the unit that shows it: "0.5 s", "2.6 min", "1,204.3 h"."""
    if seconds < 90:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.1f} min" if seconds < 5400 else f"{seconds / 3600:,.1f} h"


def printable(text: str) -> str:
    """A text as one line that is safe on a terminal: control characters as escapes (`\\x1b`, `\\n`).

    Also direction marks, and bytes of a file name that are not UTF-8.
    """
    return UNSAFE_LETTERS.sub(lambda letter: letter[0].encode("unicode_escape", "surrogatepass").decode("ascii"), text)


def markdown_text(text: str) -> str:
    """A text as one line of Markdown that shows it as it is: characters with a meaning there are escaped."""
    return re.sub(r"[\\`*_\[\]<>|~&!$]", r"\\\g<0>", printable(text))


def shortened(text: str, limit: int) -> str:
    """A text of at most about `limit` characters, shortened in the middle, since the end has the advice."""
    if len(text) <= limit:
        return text
    return f"{text[: limit // 2]} … ({len(text) - limit:,} letters left out) … {text[-(limit - limit // 2) :]}"
