"""What commands share: options and their parsing; results and tables on stdout, progress and messages on stderr."""

import json
import re
import shlex
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from rich.console import Console

from motionkit.core.errors import UNSAFE_LETTERS, FormatError, MotionkitWarning, UsageError, printable, shortened
from motionkit.core.progress import OnProgress, Progress

if TYPE_CHECKING:
    from motionkit.io.registry import ReadOptions


Axis = Literal["x", "y", "z"]

# Options of several commands.
Up = Annotated[
    Axis | None,
    typer.Option(help="The files' axis that points up; by default inferred from the motion.", show_default=False),
]
Clips = Annotated[
    list[str] | None, typer.Argument(help="Files, folders, or ids of stored sequences.", show_default=False)
]
Where = Annotated[
    str | None, typer.Option(metavar="SQL", help="Stored sequences that satisfy this condition: \"action = 'walk'\".")
]
FileFormat = Annotated[
    Literal["bvh", "csv", "glb", "npz"] | None,
    typer.Option("--format", help="Format of the files.", show_default="--out's, or the clip's own"),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what an earlier call wrote there.")]
SourceFps = Annotated[
    str | None, typer.Option(help="Framerate of clips whose files state none or a wrong one (.amc, .npy).")
]
SkeletonMaps = Annotated[
    list[Path] | None, typer.Option(help="TOML that maps a rig to the 22 joints (docs/formats.md).")
]
Onto = Annotated[
    Path | None, typer.Option(help="A character's .bvh or .glb: its bones and names, its file.", show_default=False)
]
RunsFolder = Annotated[Path | None, typer.Option(help="Folder of all runs.", show_default="./runs")]
StorePath = Annotated[Path | None, typer.Option(help="Store of sequence ids.", show_default="./store")]
AsJson = Annotated[bool, typer.Option("--json", help="Print what was done as JSON.")]
StoreArgument = Annotated[
    Path | None, typer.Argument(metavar="STORE", help="The store, as with --store.", show_default=False)
]


def named_store(argument: Path | None, option: Path | None) -> Path | None:
    """The store named by position or by --store, None for the default; raises `UsageError` for both."""
    if argument is not None and option is not None:
        raise UsageError(f"two stores, {argument} and --store {option}: name one")
    return argument or option


def of_default(option: str, given: Path | None) -> str:
    """An option as text for a suggested command; empty for the default."""
    return "" if given is None else f" {option} {shlex.quote(str(given))}"


def parse_rate(text: str | None, option: str = "--fps") -> Fraction | None:
    """Parse an option's framerate; raises `UsageError` that names the option."""
    from motionkit.core.timegrid import parse_fps  # deferred: numpy

    try:
        return None if text is None else parse_fps(text)
    except ValueError as error:
        raise UsageError(f"{option} {text}: {error}") from None


def parse_duration(text: str, option: str) -> float:
    """Seconds of "90s", "20m" or "1.5h"; raises `UsageError` that names the option."""
    found = re.fullmatch(r"(\d+(?:\.\d+)?)(s|m|h)", text)
    if found is None or not float(found[1]):
        raise UsageError(f"{option} {text}: a number above 0 with its unit, such as 90s, 20m or 1.5h")
    return float(found[1]) * {"s": 1.0, "m": 60.0, "h": 3600.0}[found[2]]


def of_source(message: str, error: Exception) -> str:
    """A reader's error for commands in which `--fps` is the new framerate and `--source-fps` that of the file."""
    return re.sub(r"--fps\b(?!-)", "--source-fps", message) if isinstance(error, FormatError) else message


def read_options(
    fps: Fraction | None,
    skeleton_maps: Sequence[Path] | None,
    unit_metres: float | None = None,
    up: Axis | None = None,
    **others: Any,
) -> "ReadOptions":
    """The options of readers; `others` are fields of `ReadOptions`. Raises `UsageError` for an invalid unit."""
    from motionkit.core.skeletons.mapping import read_skeleton_map
    from motionkit.io.registry import ReadOptions

    if unit_metres is not None and not 0 < unit_metres < float("inf"):
        raise UsageError(f"--unit-metres must be a positive number, not {unit_metres}")
    maps = tuple(map(read_skeleton_map, skeleton_maps or ()))
    return ReadOptions(fps=fps, skeleton_maps=maps, unit_metres=unit_metres, up=up or "", **others)


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
