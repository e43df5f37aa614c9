"""Results on stdout, progress and messages on stderr."""

import json
import re
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console

from motionkit.core.errors import MotionkitWarning
from motionkit.core.plain_text import UNSAFE_LETTERS, printable, shortened
from motionkit.core.progress import OnProgress, Pace, Progress

# Messages quote files' content, which may be long.
LONGEST_MESSAGE = 3000


class LineConsole(Console):
    """A console that escapes control characters, since file names may contain terminal sequences.

    Texts longer than `longest` characters are shortened in the middle.
    """

    def __init__(self, longest: int | None = None, **options: Any) -> None:
        super().__init__(soft_wrap=True, highlight=False, markup=False, emoji=False, **options)
        self._longest = longest

    def print(self, *objects: Any, **options: Any) -> None:
        """Print texts with control characters and line breaks escaped; rich's objects unchanged."""
        super().print(*(self._line(each) if isinstance(each, str) else each for each in objects), **options)

    def _line(self, text: str) -> str:
        line = printable(text)
        return line if self._longest is None else shortened(line, self._longest)


stdout = LineConsole()
stderr = LineConsole(LONGEST_MESSAGE, stderr=True)


def say_next(command: str) -> None:
    """Print the next command on the way from captures to a table."""
    stdout.print(f"next: {command}")


def print_text(text: str) -> None:
    """Print lines on stdout, with control characters escaped."""
    for line in text.removesuffix("\n").split("\n"):
        print(printable(line))


def print_json(value: Any) -> None:
    """Print a value as JSON on stdout; raises `ValueError` for NaN, which is not JSON.

    Control characters use JSON's escapes; bytes of a file name that are not UTF-8 become the text of their escape,
    since not every parser accepts lone surrogates.
    """
    text = json.dumps(value, indent=2, allow_nan=False, ensure_ascii=False)
    print("\n".join(UNSAFE_LETTERS.sub(_json_escape, line) for line in text.split("\n")))


def _json_escape(found: re.Match[str]) -> str:
    number = ord(found[0])
    return f"\\\\u{number:04x}" if 0xD800 <= number < 0xE000 else f"\\u{number:04x}"


def show_warnings() -> None:
    """Print motionkit's own warnings as lines on stderr from now on; others as Python does."""
    others = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *place: Any, **options: Any) -> None:
        if issubclass(category, MotionkitWarning):
            stderr.print(f"motionkit: warning: {message}")
        else:
            others(message, category, *place, **options)

    warnings.simplefilter("always", MotionkitWarning)
    warnings.showwarning = show


class ProgressLines:
    """A progress callback that prints a line on stderr for all running tasks, at most every `every_seconds`.

    Tasks that end before that have no line.
    """

    def __init__(self, every_seconds: float = 60.0, clock: Callable[[], float] = time.monotonic) -> None:
        self._every, self._clock = every_seconds, clock
        self._printed = clock()
        self._tasks: dict[str, Pace] = {}

    def __call__(self, progress: Progress) -> None:
        """Record a task's new state; print the line if it is due."""
        if progress.finished:
            self._tasks.pop(progress.name, None)
            return
        self._tasks.setdefault(progress.name, Pace(progress, self._clock)).update(progress)
        if self._clock() - self._printed >= self._every:
            self._printed = self._clock()
            stderr.print("; ".join(_state(pace) for pace in self._tasks.values()))


def _state(pace: Pace) -> str:
    """`field: 1,200 of 8,000 (15 %), about 4 min left, loss 0.1`."""
    progress, left = pace.progress, pace.seconds_left()
    facts = [f"{progress.done:,}"]
    if progress.total:
        facts = [f"{progress.done:,} of {progress.total:,} ({progress.done / progress.total:.0%})"]
        if left is not None:
            facts.append(f"about {left / 60:,.0f} min left" if left >= 90 else f"about {left:.0f} s left")
    return f"{progress.name}: {', '.join(filter(None, (*facts, progress.note)))}"


@contextmanager
def progress() -> Iterator[OnProgress]:
    """A callback that draws progress bars on stderr, or prints a line every minute if it is no terminal."""
    if not stderr.is_terminal:
        yield ProgressLines()
        return
    from motionkit.cli.bars import Bars

    bars = Bars(stderr)
    try:
        yield bars
    finally:
        bars.stop()
