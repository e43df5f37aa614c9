"""Progress by callbacks, and warnings by Python's `warnings`.

    store = Store.open("store", on_progress=show)
    warnings.simplefilter("ignore", MotionkitWarning)

The command line draws the progress, and prints each warning as one line.
"""

import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TypeVar

from motionkit.core.errors import MotionkitWarning

T = TypeVar("T")


@dataclass(frozen=True)
class Progress:
    """The state of one task, known by its name: `done` of `total` steps (None: unknown), and a short note.

    `finished` marks the last report of a task, whether it was completed or not.
    """

    name: str
    done: int = 0
    total: int | None = None
    note: str = ""
    finished: bool = False


OnProgress = Callable[[Progress], None]


def ignore(progress: Progress) -> None:
    """Ignore a report: the default callback."""


class Task:
    """A running task; each method reports its new state to the callback."""

    def __init__(self, on_progress: OnProgress, progress: Progress) -> None:
        self._on_progress, self._progress = on_progress, progress
        on_progress(progress)

    def advance(self, count: int = 1) -> None:
        """Add steps to those done."""
        self._report(replace(self._progress, done=self._progress.done + count))

    def set_total(self, total: int) -> None:
        """Set the number of steps, once it is known."""
        self._report(replace(self._progress, total=total))

    def note(self, text: str) -> None:
        """Set the note beside the numbers, such as the name of the current file."""
        self._report(replace(self._progress, note=text))

    def finish(self) -> None:
        """Send the last report."""
        self._report(replace(self._progress, finished=True))

    def _report(self, progress: Progress) -> None:
        self._progress = progress
        self._on_progress(progress)


@contextmanager
def task(
    on_progress: OnProgress, name: str, total: int | None = None, *, done: int = 0, note: str = ""
) -> Iterator[Task]:
    """A task for a `with` block; it is finished on errors too."""
    started = Task(on_progress, Progress(name, done, total, note))
    try:
        yield started
    finally:
        started.finish()


def tracked(on_progress: OnProgress, name: str, items: Iterable[T], total: int) -> Iterator[T]:
    """Iterate over items as a task; an item is done when the next one is requested."""
    with task(on_progress, name, total) as work:
        for item in items:
            yield item
            work.advance()


def warn(message: str) -> None:
    """Issue a `MotionkitWarning`, attributed to the calling line outside of motionkit."""
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == "motionkit":
        frame, level = frame.f_back, level + 1
    warnings.warn(message, MotionkitWarning, stacklevel=level)
