"""`motionkit complete`: more frames between those of a clip, its gaps closed, its ends continued."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from motionkit.console import print_json, progress, stderr, stdout
from motionkit.errors import MotionkitError, UsageError
from motionkit.settings import default_path

if TYPE_CHECKING:
    from motionkit.completing.clips import ClipSource
    from motionkit.completing.job import CompletedClip, Job, OutputPath

FORMATS = ("bvh", "npz")


def complete(
    clips: Annotated[list[str], typer.Argument(help="Files, folders, or ids of stored sequences.", show_default=False)],
    fps: Annotated[
        str | None, typer.Option(help="New framerate, any: 120, 23.976, 60000/1001.", show_default="the clip's own")
    ] = None,
    keep: Annotated[
        str | None,
        typer.Option(metavar="A:B,…", help="Frames to keep, [A, B) counted from 0; all others are made anew."),
    ] = None,
    extend: Annotated[
        str | None,
        typer.Option(metavar="BEFORE,AFTER", help="Seconds to add before and after, or frames of the clip: 0,15f."),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(
            help="A trained encoder (pahires …) or an interpolator (slerp, spline, hold …).",
            show_default="a trained pahires if there is one, else spline",
        ),
    ] = None,
    run: Annotated[
        str | None, typer.Option(help="Run that holds the trained encoder.", show_default="the one trained last")
    ] = None,
    runs: Annotated[Path | None, typer.Option(help="Folder of all runs.", show_default="./runs")] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="File, or folder for several clips.", show_default="NAME.completed.EXT beside each"),
    ] = None,
    file_format: Annotated[
        str | None, typer.Option("--format", help="Write bvh or npz instead of the clip's own format.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace files that exist.")] = False,
    compare: Annotated[
        str | None,
        typer.Option(metavar="NAME,…", help="Also write an HTML page with moving skeletons: slerp,spline."),
    ] = None,
    source_fps: Annotated[
        str | None, typer.Option(help="Framerate of clips whose files say none or a wrong one (.amc, .npy).")
    ] = None,
    skeleton_map: Annotated[
        list[Path] | None, typer.Option(help="TOML that says how a rig becomes the 22 joints (docs/formats.md).")
    ] = None,
    store: Annotated[Path | None, typer.Option(help="Store of sequence ids.", show_default="./store")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print what was written as JSON.")] = False,
) -> None:
    """Complete clips: a higher framerate, gaps closed, ends continued; given frames and bones stay as they are."""
    from motionkit.completing.request import CompletionRequest, Reach, parse_extend, parse_keep, parse_target_fps

    before, after = parse_extend(extend) if extend else (Reach(0.0), Reach(0.0))
    request = CompletionRequest(
        fps=parse_target_fps(fps) if fps else None,
        keep=parse_keep(keep) if keep else (),
        before=before,
        after=after,
    )
    if file_format is not None and file_format not in FORMATS:
        raise UsageError(f"--format {file_format}: expected {' or '.join(FORMATS)}")
    from motionkit.completing.clips import find_clips
    from motionkit.completing.encoder_choice import choose_encoder
    from motionkit.completing.job import Job, OutputPath
    from motionkit.formats.items import ReadOptions
    from motionkit.skeleton_families import read_skeleton_map

    options = ReadOptions(
        fps=parse_target_fps(source_fps, "--source-fps") if source_fps else None,
        skeleton_maps=tuple(map(read_skeleton_map, skeleton_map or ())),
    )
    sources, problems = find_clips(clips, options, store or default_path("store"))
    runs_folder = runs or default_path("runs")
    chosen = choose_encoder(model, run, runs_folder)
    compared = [choose_encoder(name.strip(), None, runs_folder) for name in compare.split(",")] if compare else []
    stderr.print(f"motionkit: completing with {chosen.explanation}", markup=False)
    job = Job(request, chosen, compared, None if file_format is None else f".{file_format}", overwrite=overwrite)
    failures = [(str(problem.path), str(problem)) for problem in problems]
    for problem in problems:
        stderr.print(f"motionkit: {problem}", markup=False)
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
    with progress() as display:
        task = display.add_task("complete", total=len(sources), note="")
        for source in sources:
            frames = display.add_task(source.name, total=None, note="")
            try:
                completed = job.complete(source, path_of, partial(display.advance, frames))
            except (MotionkitError, OSError) as error:
                failures.append((source.name, str(error)))
                named = str(error) if source.name in str(error) else f"{source.name}: {error}"
                stderr.print(f"motionkit: {named}", markup=False)
            else:
                done.append(completed)
                _tell(completed, as_json)
            display.remove_task(frames)
            display.advance(task)
    return done, failures


def _tell(completed: "CompletedClip", as_json: bool) -> None:
    for warning in completed.warnings:
        stderr.print(f"motionkit: warning: {completed.source}: {warning}", markup=False)
    if not as_json:
        for path in (completed.path, completed.page):
            if path is not None:
                stdout.print(str(path), markup=False)
