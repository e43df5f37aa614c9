"""`motionkit complete`: a motion at any framerate, its gaps closed, its ends continued."""

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from motionkit.cli.console import print_json, progress, stderr, stdout
from motionkit.cli.options import of_source, parse_rate, read_options
from motionkit.core.errors import MotionkitError, describe
from motionkit.core.progress import task, tracked
from motionkit.core.settings import default_path
from motionkit.training.loaders import loader_names


class ClipFormat(StrEnum):
    """What a completed clip may be written as, where not as it came."""

    BVH = "bvh"
    NPZ = "npz"


Clips = Annotated[list[str], typer.Argument(help="Files, folders, or ids of stored sequences.", show_default=False)]
TargetFps = Annotated[
    str | None, typer.Option(help="New framerate, any: 120, 23.976, 60000/1001.", show_default="the clip's own")
]
KeptFrames = Annotated[
    str | None,
    typer.Option(metavar="A:B,…", help="Frames to keep, [A, B) counted from 0; all others are made anew."),
]
Extension = Annotated[
    str | None,
    typer.Option(metavar="BEFORE,AFTER", help="Seconds to add before and after, or frames of the clip: 0,15f."),
]
TRAINED = ", ".join(loader_names("motionkit.encoders"))
EncoderName = Annotated[
    str | None,
    typer.Option(
        help=f"A trained encoder ({TRAINED}) or an interpolator (slerp, spline, hold …).",
        show_default="the preferred trained one if a run has it, else spline",
    ),
]
RunName = Annotated[
    str | None, typer.Option(help="Run that holds the trained encoder.", show_default="the one trained last")
]
RunsFolder = Annotated[Path | None, typer.Option(help="Folder of all runs.", show_default="./runs")]
OutPlace = Annotated[
    Path | None,
    typer.Option(help="File, or folder for several clips.", show_default="NAME.completed.EXT beside each"),
]
FormatChoice = Annotated[
    ClipFormat | None, typer.Option("--format", help="Write bvh or npz instead of the clip's own format.")
]
Plant = Annotated[bool, typer.Option("--plant", help="Let feet stand that slide, in what is made.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace files that exist.")]
ComparedNames = Annotated[
    str | None,
    typer.Option(metavar="NAME,…", help="Also write an HTML page with moving skeletons: slerp,spline."),
]
SourceFps = Annotated[
    str | None, typer.Option(help="Framerate of clips whose files say none or a wrong one (.amc, .npy).")
]
SkeletonMaps = Annotated[
    list[Path] | None, typer.Option(help="TOML that says how a rig becomes the 22 joints (docs/formats.md).")
]
StorePath = Annotated[Path | None, typer.Option(help="Store of sequence ids.", show_default="./store")]
AsJson = Annotated[bool, typer.Option("--json", help="Print what was written as JSON.")]


if TYPE_CHECKING:
    from motionkit.complete.clips import ClipSource
    from motionkit.complete.job import CompletedClip, Job, OutputPath


def complete(
    clips: Clips,
    fps: TargetFps = None,
    keep: KeptFrames = None,
    extend: Extension = None,
    plant: Plant = False,
    model: EncoderName = None,
    run: RunName = None,
    runs: RunsFolder = None,
    out: OutPlace = None,
    file_format: FormatChoice = None,
    overwrite: Overwrite = False,
    compare: ComparedNames = None,
    source_fps: SourceFps = None,
    skeleton_map: SkeletonMaps = None,
    store: StorePath = None,
    as_json: AsJson = False,
) -> None:
    """Complete clips: a higher framerate, gaps closed, ends continued; given frames and bones stay as they are.

    Example: motionkit complete takes/walk.bvh --fps 120 --model cubic
    """
    from motionkit.complete.request import CompletionRequest, Reach, parse_extend, parse_keep

    before, after = parse_extend(extend) if extend else (Reach(0.0), Reach(0.0))
    request = CompletionRequest(
        fps=parse_rate(fps),
        keep=parse_keep(keep) if keep else (),
        before=before,
        after=after,
        plant=plant,
    )
    from motionkit.complete.clips import find_clips
    from motionkit.complete.encoders import choose_encoder
    from motionkit.complete.job import Job, OutputPath

    options = read_options(parse_rate(source_fps, "--source-fps"), skeleton_map)
    sources, problems = find_clips(clips, options, store or default_path("store"))
    runs_folder = runs or default_path("runs")
    chosen = choose_encoder(model, run, runs_folder)
    compared = [choose_encoder(name.strip(), None, runs_folder) for name in compare.split(",")] if compare else []
    stderr.print(f"motionkit: completing with {chosen.explanation}")
    job = Job(request, chosen, compared, None if file_format is None else f".{file_format}", overwrite=overwrite)
    failures = [(str(problem.path), of_source(str(problem), problem)) for problem in problems]
    for _, message in failures:
        stderr.print(f"motionkit: {message}")
    path_of = OutputPath(out, len(sources), [Path(each) for each in clips if Path(each).is_dir()])
    done, failed = _complete_each(job, sources, path_of, as_json)
    failures += failed
    if as_json:
        print_json(
            {
                "encoder": chosen.name,
                "clips": [each.plain() for each in done],
                "failed": [{"clip": name, "message": message} for name, message in failures],
            }
        )
    if failures:
        raise typer.Exit(1)


def _complete_each(
    job: "Job", sources: "Sequence[ClipSource]", path_of: "OutputPath", as_json: bool
) -> "tuple[list[CompletedClip], list[tuple[str, str]]]":
    """What was written, and name and message of each clip that could not be: one that fails loses no other."""
    done: list[CompletedClip] = []
    failures: list[tuple[str, str]] = []
    with progress() as show:
        for source in tracked(show, "complete", sources, len(sources)):
            try:
                with task(show, source.name) as frames:
                    completed = job.complete(source, path_of, frames.advance)
            except (MotionkitError, OSError) as error:
                message = of_source(describe(error), error)
                failures.append((source.name, message))
                named = message if source.name in message else f"{source.name}: {message}"
                stderr.print(f"motionkit: {named}")
            else:
                done.append(completed)
                _print_completed(completed, as_json)
    return done, failures


def _print_completed(completed: "CompletedClip", as_json: bool) -> None:
    for warning in completed.warnings:
        stderr.print(f"motionkit: warning: {completed.source}: {warning}")
    if not as_json:
        for path in (completed.path, completed.page):
            if path is not None:
                stdout.print(str(path))
