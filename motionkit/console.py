"""Results on stdout, progress and messages on stderr."""

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from motionkit.plain_text import UNSAFE_LETTERS, printable


class LineConsole(Console):
    """A console on which a text is one line and nothing else: names of files may hold what a terminal would obey."""

    def __init__(self, **options: Any) -> None:
        super().__init__(soft_wrap=True, highlight=False, markup=False, emoji=False, **options)

    def print(self, *objects: Any, **options: Any) -> None:
        """Print texts with control characters, line breaks among them, as their escapes; rich's objects as they are."""
        super().print(*(printable(each) if isinstance(each, str) else each for each in objects), **options)


class _NameColumn(TextColumn):
    """A column of a progress display that shows a task's text, a file's name perhaps."""

    def render(self, task: Task) -> Text:
        return Text(printable(super().render(task).plain))


stdout = LineConsole()
stderr = LineConsole(stderr=True)


def print_text(text: str) -> None:
    """Print lines on stdout as they are, but for what a terminal would obey."""
    for line in text.removesuffix("\n").split("\n"):
        print(printable(line))


def print_json(value: Any) -> None:
    """Print a value as JSON on stdout; NaN is refused (it is not JSON).

    What a terminal would obey stands there as JSON's own escape, a byte of a file's name that is no UTF-8 as the text
    of its escape, for not every reader takes half a character.
    """
    text = json.dumps(value, indent=2, allow_nan=False, ensure_ascii=False)
    print("\n".join(UNSAFE_LETTERS.sub(_json_escape, line) for line in text.split("\n")))


def _json_escape(found: re.Match[str]) -> str:
    number = ord(found[0])
    return f"\\\\u{number:04x}" if 0xD800 <= number < 0xE000 else f"\\u{number:04x}"


@contextmanager
def progress() -> Iterator[Progress]:
    """A progress display on stderr, silent where stderr is not a terminal."""
    columns = (
        _NameColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        _NameColumn("{task.fields[note]}", markup=False),
    )
    with Progress(*columns, console=stderr, disable=not stderr.is_terminal, transient=True) as display:
        yield display
