"""Results on stdout, progress and messages on stderr."""

import json
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console

from motionkit.core.errors import MotionkitWarning
from motionkit.core.plain_text import UNSAFE_LETTERS, printable, shortened
from motionkit.core.progress import OnProgress, ignore

# Messages quote what files say, which may have any length.
LONGEST_MESSAGE = 3000


class LineConsole(Console):
    """A console on which a text is one line and nothing else: names of files may hold what a terminal would obey.

    Of a text of more than `longest` letters the middle is left out.
    """

    def __init__(self, longest: int | None = None, **options: Any) -> None:
        super().__init__(soft_wrap=True, highlight=False, markup=False, emoji=False, **options)
        self._longest = longest

    def print(self, *objects: Any, **options: Any) -> None:
        """Print texts with control characters, line breaks among them, as their escapes; rich's objects as they are."""
        super().print(*(self._line(each) if isinstance(each, str) else each for each in objects), **options)

    def _line(self, text: str) -> str:
        line = printable(text)
        return line if self._longest is None else shortened(line, self._longest)


stdout = LineConsole()
stderr = LineConsole(LONGEST_MESSAGE, stderr=True)


def say_next(command: str) -> None:
    """Say which command comes next on the way from captures to a table."""
    stdout.print(f"next: {command}")


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


def show_warnings() -> None:
    """Print every warning of motionkit's own as a line on stderr from now on; others as Python does."""
    others = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *place: Any, **options: Any) -> None:
        if issubclass(category, MotionkitWarning):
            stderr.print(f"motionkit: warning: {message}")
        else:
            others(message, category, *place, **options)

    warnings.simplefilter("always", MotionkitWarning)
    warnings.showwarning = show


@contextmanager
def progress() -> Iterator[OnProgress]:
    """A callback that draws progress bars on stderr; it does nothing where stderr is not a terminal."""
    if not stderr.is_terminal:
        yield ignore
        return
    from motionkit.cli.bars import Bars

    bars = Bars(stderr)
    try:
        yield bars
    finally:
        bars.stop()
