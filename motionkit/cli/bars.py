"""Progress bars on a terminal; `motionkit.cli.console` imports them where there is one."""

from datetime import timedelta
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    ProgressColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
)
from rich.progress import Progress as Display
from rich.text import Text

from motionkit.core.plain_text import printable
from motionkit.core.progress import Pace, Progress


class _NameColumn(TextColumn):
    """A column of a progress display that shows a task's text, a file's name perhaps."""

    def render(self, task: Task) -> Text:
        return Text(printable(super().render(task).plain))


class _TimeLeftColumn(ProgressColumn):
    """A column of a progress display with the time left, where it is known."""

    def render(self, task: Task) -> Text:
        seconds = task.fields["pace"].seconds_left()
        text = "-:--:--" if seconds is None else str(timedelta(seconds=round(seconds)))
        return Text(text, style="progress.remaining")


class Bars:
    """A callback: one bar for each task that is under way; without any, nothing is drawn."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._display: Display | None = None
        self._tasks: dict[str, tuple[TaskID, Pace]] = {}

    def __call__(self, progress: Progress) -> None:
        """Draw a task's new state; remove the bar of a finished one."""
        if progress.finished:
            if self._display is not None and progress.name in self._tasks:
                self._display.remove_task(self._tasks.pop(progress.name)[0])
            if not self._tasks:
                self.stop()
            return
        if self._display is None:
            self._display = Display(*_columns(), console=self._console, transient=True)
            self._display.start()
        facts: dict[str, Any] = {"completed": progress.done, "total": progress.total, "note": progress.note}
        if progress.name in self._tasks:
            number, pace = self._tasks[progress.name]
            pace.update(progress)
            self._display.update(number, **facts)
        else:
            pace = Pace(progress)
            self._tasks[progress.name] = self._display.add_task(progress.name, **facts, pace=pace), pace

    def stop(self) -> None:
        """Remove all bars."""
        if self._display is not None:
            self._display.stop()
        self._display, self._tasks = None, {}


def _columns() -> tuple[ProgressColumn, ...]:
    return (
        _NameColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        _TimeLeftColumn(),
        _NameColumn("{task.fields[note]}", markup=False),
    )
