"""Processes clips one by one, for `complete` and `plant`; a failure does not stop the others."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import typer

from motionkit.cli.console import print_json, progress, stderr, stdout
from motionkit.cli.options import of_source
from motionkit.core.errors import FormatError, MotionkitError, describe
from motionkit.core.progress import task, tracked

if TYPE_CHECKING:
    from motionkit.edit.complete.clips import ClipSource, Progress
    from motionkit.edit.complete.job import CompletedClip
    from motionkit.edit.plant.job import PlantedClip


def write_each(
    verb: str,
    found: "tuple[Sequence[ClipSource], Sequence[FormatError]]",
    write: "Callable[[ClipSource, Progress], CompletedClip | PlantedClip]",
    remarks: Callable[[Any], Iterable[str]],
    about: Mapping[str, Any] | None,
) -> None:
    """Write a file for every clip, and print its path, or JSON that begins with `about`.

    Exits with 1 if a clip cannot be read or processed; messages and `remarks` go to stderr.
    """
    sources, problems = found
    failures = [(str(problem.path), of_source(str(problem), problem)) for problem in problems]
    for _, message in failures:
        stderr.print(f"motionkit: {message}")
    done: list[CompletedClip | PlantedClip] = []
    with progress() as show:
        for source in tracked(show, verb, sources, len(sources)):
            try:
                with task(show, source.name) as frames:
                    written = write(source, frames.advance)
            except (MotionkitError, OSError) as error:
                message = of_source(describe(error), error)
                failures.append((source.name, message))
                stderr.print(f"motionkit: {message if source.name in message else f'{source.name}: {message}'}")
                continue
            done.append(written)
            for remark in remarks(written):
                stderr.print(f"motionkit: {remark}")
            for path in (written.path, written.page) if about is None else ():
                if path is not None:
                    stdout.print(str(path))
    if about is not None:
        failed = [{"clip": name, "message": message} for name, message in failures]
        print_json({**about, "clips": [each.plain() for each in done], "failed": failed})
    if failures:
        raise typer.Exit(1)
