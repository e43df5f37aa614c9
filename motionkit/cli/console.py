"""Results and tables on stdout, progress and messages on stderr."""

import json
import re
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from rich.console import Console

from motionkit.core.errors import UNSAFE_LETTERS, MotionkitWarning, printable, shortened
from motionkit.core.progress import OnProgress, Progress

# Messages quote files' content, which may be long.
LONGEST_MESSAGE = 3000
# Of tables: characters of a row's name, and between columns.
LONGEST_ROW_NAME, GAP = 30, 2


class LineConsole(Console):
    """A console that escapes control characters, since file names may contain terminal sequences.

    Texts longer than `longest` characters are shortened in the middle.
    """

    def __init__(self, longest: int = sys.maxsize, **options: Any) -> None:
        super().__init__(soft_wrap=True, highlight=False, markup=False, emoji=False, **options)
        self._longest = longest

    def print(self, *objects: Any, **options: Any) -> None:
        """Print texts with control characters and line breaks escaped; rich's objects unchanged."""
        shown = (shortened(printable(each), self._longest) if isinstance(each, str) else each for each in objects)
        super().print(*shown, **options)


stdout = LineConsole()
stderr = LineConsole(LONGEST_MESSAGE, stderr=True)


def print_failures(failures: Iterable[tuple[str, str]]) -> None:
    """Print a line on stderr for the name of each motion that failed and its message."""
    for name, message in failures:
        stderr.print(f"motionkit: {message if name in message else f'{name}: {message}'}")


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


def progress_lines(clock: Callable[[], float] = time.monotonic) -> OnProgress:
    """A progress callback that prints a line on stderr for all running tasks, once a minute at most."""
    tasks: dict[str, Progress] = {}
    printed = clock()

    def show(progress: Progress) -> None:
        nonlocal printed
        tasks[progress.name] = progress
        if progress.finished:
            del tasks[progress.name]
        elif clock() - printed >= 60.0:
            printed = clock()
            stderr.print("; ".join(map(_state, tasks.values())))

    return show


def _state(task: Progress) -> str:
    """`field: 1,200 of 8,000 (15%), loss 0.1`."""
    state = f"{task.done:,} of {task.total:,} ({task.done / task.total:.0%})" if task.total else f"{task.done:,}"
    return f"{task.name}: {state}" + (f", {task.note}" if task.note else "")


@contextmanager
def progress() -> Iterator[OnProgress]:
    """A callback that draws progress bars on stderr, or prints a line every minute if it is no terminal."""
    if not stderr.is_terminal:
        yield progress_lines()
        return
    import rich.progress as bars  # deferred: it takes longer than a short command

    columns = (
        bars.TextColumn("{task.description}", markup=False),
        *(bars.BarColumn(), bars.MofNCompleteColumn(), bars.TimeElapsedColumn(), bars.TimeRemainingColumn()),
        bars.TextColumn("{task.fields[note]}", markup=False),
    )
    with bars.Progress(*columns, console=stderr, transient=True, redirect_stdout=False) as display:
        tasks: dict[str, bars.TaskID] = {}

        def show(progress: Progress) -> None:
            name = progress.name
            if progress.finished:
                if name in tasks:
                    display.remove_task(tasks.pop(name))
                return
            state: dict[str, Any] = {"total": progress.total, "note": printable(progress.note)}
            if name not in tasks:
                tasks[name] = display.add_task(printable(name), completed=progress.done, **state)
            display.update(tasks[name], completed=progress.done, **state)

        yield show


def print_table(columns: Sequence[str], rows: Sequence[tuple[str, Sequence[str]]], console: Console = stdout) -> None:
    """Print each row's name and its number (or a dash) in each column, in several tables if the columns do not fit.

    Where they do not fit, numbers are broken before their ±.
    """
    from rich.table import Table

    titles = [printable(column) for column in columns]
    cells = [(printable(name), *(printable(text).replace("± ", "±") for text in numbers)) for name, numbers in rows]
    label = min(LONGEST_ROW_NAME, max((len(name) for name, *_ in cells), default=0))
    texts = list(zip(titles, *(numbers for _, *numbers in cells), strict=True))
    widths = [max(map(len, column)) for column in texts]
    room = console.width - label - GAP
    if sum(widths) + GAP * len(widths) > room:
        widths = [max(len(word) for text in column for word in text.split(" ")) for column in texts]
    first = 0
    while first < len(titles):
        last, room = first, console.width - label - GAP
        while last < len(titles) and (last == first or widths[last] + GAP <= room):
            room -= widths[last] + GAP
            last += 1
        table = Table(box=None, padding=(0, GAP, 0, 0), pad_edge=False, show_edge=False)
        table.add_column("", width=label, overflow="fold")
        for title, width in zip(titles[first:last], widths[first:last], strict=True):
            table.add_column(title, justify="right", width=width, overflow="fold")
        for name, *numbers in cells:
            table.add_row(name, *numbers[first:last])
        console.print(table, soft_wrap=False)
        console.print("")
        first = last
