"""`motionkit plant`: feet that slide, made to stand."""

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from motionkit.cli.complete import ClipFormat, SkeletonMaps, SourceFps, StorePath
from motionkit.cli.console import print_json, progress, stderr, stdout
from motionkit.cli.options import of_source, parse_rate, read_options
from motionkit.core.errors import MotionkitError, UsageError, describe
from motionkit.core.progress import task, tracked
from motionkit.core.settings import default_path


class BodyPath(StrEnum):
    """Where a body may go whose feet stand."""

    NEAR = "near"
    FREE = "free"


Clips = Annotated[
    list[str] | None, typer.Argument(help="Files, folders, or ids of stored sequences.", show_default=False)
]
Where = Annotated[
    str | None, typer.Option(metavar="SQL", help="Stored sequences for which this holds: \"action = 'walk'\".")
]
PathOfBody = Annotated[
    BodyPath, typer.Option("--path", help="Keep near the path that was given, or go where feet that stand carry it.")
]
OutPlace = Annotated[
    Path | None, typer.Option(help="File, or folder for several clips.", show_default="NAME.planted.EXT beside each")
]
FormatChoice = Annotated[
    ClipFormat | None, typer.Option("--format", help="Write bvh or npz instead of the clip's own format.")
]
Page = Annotated[bool, typer.Option("--page", help="Also write an HTML page with both skeletons, before and after.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace files that exist.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print what was written, and how much was moved, as JSON.")]


if TYPE_CHECKING:
    from motionkit.complete.clips import ClipSource
    from motionkit.complete.job import OutputPath
    from motionkit.plant.job import Job, PlantedClip


def plant(
    clips: Clips = None,
    where: Where = None,
    path: PathOfBody = BodyPath.NEAR,
    out: OutPlace = None,
    file_format: FormatChoice = None,
    page: Page = False,
    overwrite: Overwrite = False,
    source_fps: SourceFps = None,
    skeleton_map: SkeletonMaps = None,
    store: StorePath = None,
    as_json: AsJson = False,
) -> None:
    """Let feet stand that slide, in captures and in anybody's samples; bones keep their length.

    With --store and no clip, all sequences of the store (or those of --where), into --out.

    Example: motionkit plant takes/walk.bvh --page
    """
    from motionkit.complete.clips import clip_of_motion, find_clips
    from motionkit.complete.job import OutputPath
    from motionkit.formats.scan.made import PLANTED
    from motionkit.plant.job import Job
    from motionkit.store.named_motions.reading import find_stored

    place = store or default_path("store")
    options = read_options(parse_rate(source_fps, "--source-fps"), skeleton_map)
    if not clips and (out is None or (store is None and where is None)):
        raise UsageError("name clips or folders; or a store (--store) and a folder for its sequences (--out)")
    sources, problems = find_clips(clips or [], options, place)
    if where is not None or not clips:
        sources += find_stored(place, where or "true", clip_of_motion)
    job = Job(path.value, page, None if file_format is None else f".{file_format}", overwrite)
    failures = [(str(problem.path), of_source(str(problem), problem)) for problem in problems]
    for _, message in failures:
        stderr.print(f"motionkit: {message}")
    named = [Path(each) for each in clips or () if Path(each).is_dir()]
    done, failed = _plant_each(job, sources, OutputPath(out, len(sources), named, PLANTED), as_json)
    failures += failed
    if as_json:
        print_json(
            {
                "path": path.value,
                "clips": [each.plain() for each in done],
                "failed": [{"clip": name, "message": message} for name, message in failures],
            }
        )
    if failures:
        raise typer.Exit(1)


def _plant_each(
    job: "Job", sources: "Sequence[ClipSource]", path_of: "OutputPath", as_json: bool
) -> "tuple[list[PlantedClip], list[tuple[str, str]]]":
    """What was written, and name and message of each clip that could not be: one that fails loses no other."""
    done: list[PlantedClip] = []
    failures: list[tuple[str, str]] = []
    with progress() as show:
        for source in tracked(show, "plant", sources, len(sources)):
            try:
                with task(show, source.name) as frames:
                    planted = job.plant(source, path_of, frames.advance)
            except (MotionkitError, OSError) as error:
                message = of_source(describe(error), error)
                failures.append((source.name, message))
                named = message if source.name in message else f"{source.name}: {message}"
                stderr.print(f"motionkit: {named}")
            else:
                done.append(planted)
                _print_planted(planted, as_json)
    return done, failures


def _print_planted(planted: "PlantedClip", as_json: bool) -> None:
    if planted.note:
        stderr.print(f"motionkit: warning: {planted.source}: {planted.note}")
    change = planted.change
    if change.sliding_before is not None and change.sliding_after is not None:
        stderr.print(
            f"motionkit: {planted.source}: {change.num_contacts:,} contacts, which slid at "
            f"{100 * change.sliding_before:.1f} cm/s, now {100 * change.sliding_after:.1f}; joints moved by up to "
            f"{1000 * change.largest_change:.0f} mm"
        )
    if not as_json:
        for path in (planted.path, planted.page):
            if path is not None:
                stdout.print(str(path))
