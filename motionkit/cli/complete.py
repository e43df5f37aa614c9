"""`motionkit complete`: more frames between those of a clip, its gaps closed, its ends continued."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from motionkit.cli import complete_options as option
from motionkit.console import print_json, progress, stderr, stdout
from motionkit.core.progress import task, tracked
from motionkit.errors import MotionkitError, describe
from motionkit.settings import default_path

if TYPE_CHECKING:
    from motionkit.completing.clips import ClipSource
    from motionkit.completing.job import CompletedClip, Job, OutputPath


def complete(
    clips: option.Clips,
    fps: option.TargetFps = None,
    keep: option.KeptFrames = None,
    extend: option.Extension = None,
    model: option.EncoderName = None,
    run: option.RunName = None,
    runs: option.RunsFolder = None,
    out: option.OutPlace = None,
    file_format: option.FormatChoice = None,
    overwrite: option.Overwrite = False,
    compare: option.ComparedNames = None,
    source_fps: option.SourceFps = None,
    skeleton_map: option.SkeletonMaps = None,
    store: option.StorePath = None,
    as_json: option.AsJson = False,
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
    from motionkit.completing.clips import find_clips
    from motionkit.completing.encoder_choice import choose_encoder
    from motionkit.completing.job import Job, OutputPath
    from motionkit.formats.items import ReadOptions
    from motionkit.skeletons.families import read_skeleton_map

    options = ReadOptions(
        fps=parse_target_fps(source_fps, "--source-fps") if source_fps else None,
        skeleton_maps=tuple(map(read_skeleton_map, skeleton_map or ())),
    )
    sources, problems = find_clips(clips, options, store or default_path("store"))
    runs_folder = runs or default_path("runs")
    chosen = choose_encoder(model, run, runs_folder)
    compared = [choose_encoder(name.strip(), None, runs_folder) for name in compare.split(",")] if compare else []
    stderr.print(f"motionkit: completing with {chosen.explanation}")
    job = Job(request, chosen, compared, None if file_format is None else f".{file_format}", overwrite=overwrite)
    failures = [(str(problem.path), str(problem)) for problem in problems]
    for problem in problems:
        stderr.print(f"motionkit: {problem}")
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
                message = describe(error)
                failures.append((source.name, message))
                named = message if source.name in message else f"{source.name}: {message}"
                stderr.print(f"motionkit: {named}")
            else:
                done.append(completed)
                _tell(completed, as_json)
    return done, failures


def _tell(completed: "CompletedClip", as_json: bool) -> None:
    for warning in completed.warnings:
        stderr.print(f"motionkit: warning: {completed.source}: {warning}")
    if not as_json:
        for path in (completed.path, completed.page):
            if path is not None:
                stdout.print(str(path))
