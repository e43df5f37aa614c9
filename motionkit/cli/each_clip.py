"""Edits motions one by one, for `complete`, `plant` and `convert`; a failure does not stop the others."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import typer

from motionkit.cli.console import print_json, progress, stderr, stdout
from motionkit.cli.options import of_source
from motionkit.core.errors import FormatError, MotionkitError, describe
from motionkit.core.progress import tracked

if TYPE_CHECKING:
    from motionkit.edit.motions import MotionSource, WrittenMotion


def edit_each(
    verb: str,
    sources: "Sequence[MotionSource]",
    problems: Sequence[FormatError],
    edit: "Callable[[MotionSource], WrittenMotion]",
    as_json: bool,
    about: Mapping[str, Any],
) -> None:
    """Write a file for every motion, and print its path, or JSON that begins with `about`.

    Exits with 1 if a motion cannot be read or edited; messages and remarks go to stderr.
    """
    failures = [(str(problem.path), of_source(str(problem), problem)) for problem in problems]
    for _, message in failures:
        stderr.print(f"motionkit: {message}")
    done: list[WrittenMotion] = []
    with progress() as show:
        for source in tracked(show, verb, sources, len(sources)):
            try:
                written = edit(source)
            except (MotionkitError, OSError) as error:
                message = of_source(describe(error), error)
                failures.append((source.name, message))
                stderr.print(f"motionkit: {message if source.name in message else f'{source.name}: {message}'}")
                continue
            done.append(written)
            for remark in written.remarks:
                stderr.print(f"motionkit: {remark}")
            for path in () if as_json else filter(None, (written.path, written.page)):
                stdout.print(str(path))
    if as_json:
        failed = [{"clip": name, "message": message} for name, message in failures]
        print_json({**about, "clips": [each.plain() for each in done], "failed": failed})
    if failures:
        raise typer.Exit(1)
