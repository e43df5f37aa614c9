"""`motionkit complete`, `plant` and `convert`: motions of files and stores in, edited files out.

A motion that cannot be read or edited does not stop the others.
"""

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from motionkit.cli import console
from motionkit.core import plugins
from motionkit.core.errors import FormatError, MotionkitError, UsageError, describe
from motionkit.core.files import default_path
from motionkit.core.progress import tracked

if TYPE_CHECKING:
    from motionkit.edit.motions import EditedMotion, LoadedMotion, MotionSource, OutputPaths

TRAINED = ", ".join(plugins.names("ENCODERS"))


def complete(
    clips: Annotated[list[str], typer.Argument(help="Files, folders, or ids of stored sequences.", show_default=False)],
    fps: Annotated[
        str | None, typer.Option(help="New framerate, any: 120, 23.976, 60000/1001.", show_default="the clip's own")
    ] = None,
    keep: Annotated[
        str | None,
        typer.Option(metavar="A:B,…", help="Frames to keep, [A, B) counted from 0; all others are replaced."),
    ] = None,
    extend: Annotated[
        str | None, typer.Option(metavar="BEFORE,AFTER", help="Seconds to add before and after: 0,0.5.")
    ] = None,
    plant: Annotated[bool, typer.Option("--plant", help="Make sliding feet stand, in what is made.")] = False,
    model: Annotated[
        str | None,
        typer.Option(
            help=f"A trained encoder ({TRAINED}) or an interpolator (slerp, spline, hold …).",
            show_default="the preferred trained one if a run has it, else spline",
        ),
    ] = None,
    run: Annotated[
        str | None, typer.Option(help="Run that holds the trained encoder.", show_default="the one trained last")
    ] = None,
    runs: console.RunsFolder = None,
    out: Annotated[
        Path | None,
        typer.Option(help="File, or folder for several clips.", show_default="NAME.completed.EXT beside each"),
    ] = None,
    file_format: console.FileFormat = None,
    overwrite: console.Overwrite = False,
    source_fps: console.SourceFps = None,
    skeleton_map: console.SkeletonMaps = None,
    store: console.StorePath = None,
    as_json: console.AsJson = False,
) -> None:
    """Complete clips: a higher framerate, gaps filled, ends continued; given frames and bone lengths are kept.

    Example: motionkit complete takes/walk.bvh --fps 120 --model cubic
    """
    from motionkit.edit.complete import CompletionRequest, completed_motion, parse_extend, parse_keep
    from motionkit.edit.encoders import choose_encoder
    from motionkit.edit.motions import OutputPaths, find_motions
    from motionkit.io.scan import COMPLETED

    before, after = parse_extend(extend or "0")
    request = CompletionRequest(console.parse_rate(fps), parse_keep(keep) if keep else None, before, after, plant)
    options = console.read_options(console.parse_rate(source_fps, "--source-fps"), skeleton_map, skip_derived=True)
    sources, problems = find_motions(clips, options, store or default_path("store"))
    paths = OutputPaths(COMPLETED, clips, len(sources), out=out, file_format=file_format, overwrite=overwrite)
    chosen = choose_encoder(model, run, runs or default_path("runs"))
    console.stderr.print(f"motionkit: completing with {chosen.explanation}")
    edit = partial(completed_motion, request=request, chosen=chosen)
    _edit_each("complete", sources, problems, edit, paths, as_json, {"encoder": chosen.name}, request.fps)


def plant(
    clips: console.Clips = None,
    where: console.Where = None,
    path: Annotated[
        Literal["near", "free"],
        typer.Option("--path", help="Keep the body near its own path, or let the standing feet carry it."),
    ] = "near",
    out: Annotated[
        Path | None,
        typer.Option(help="File, or folder for several clips.", show_default="NAME.planted.EXT beside each"),
    ] = None,
    file_format: console.FileFormat = None,
    overwrite: console.Overwrite = False,
    source_fps: console.SourceFps = None,
    skeleton_map: console.SkeletonMaps = None,
    store: console.StorePath = None,
    as_json: console.AsJson = False,
) -> None:
    """Make sliding feet stand, in captures and in anybody's samples; bones keep their length.

    With --store and no clip, all sequences of the store (or those of --where), into --out.

    Example: motionkit plant takes/walk.bvh
    """
    from motionkit.edit.motions import OutputPaths, find_motions
    from motionkit.edit.plant import planted_motion
    from motionkit.io.scan import PLANTED

    if not clips and (out is None or (store is None and where is None)):
        raise UsageError("name clips or folders; or a store (--store) and a folder for its sequences (--out)")
    options = console.read_options(console.parse_rate(source_fps, "--source-fps"), skeleton_map, skip_derived=True)
    where = where if clips else where or "true"
    sources, problems = find_motions(clips or (), options, store or default_path("store"), where)
    paths = OutputPaths(PLANTED, clips or (), len(sources), out=out, file_format=file_format, overwrite=overwrite)
    _edit_each("plant", sources, problems, partial(planted_motion, path=path), paths, as_json, {"path": path})


def convert(
    source: Annotated[
        str, typer.Argument(metavar="IN", help="File, folder, or id of a stored sequence.", show_default=False)
    ],
    out: Annotated[
        Path, typer.Argument(metavar="OUT", help="File (its suffix is the format), or a folder.", show_default=False)
    ],
    fps: Annotated[
        str | None, typer.Option(help="New framerate, any: 60, 23.976, 30000/1001.", show_default="the file's own")
    ] = None,
    onto: console.Onto = None,
    up: console.Up = None,
    file_format: console.FileFormat = None,
    overwrite: console.Overwrite = False,
    source_fps: console.SourceFps = None,
    skeleton_map: console.SkeletonMaps = None,
    store: console.StorePath = None,
    as_json: console.AsJson = False,
) -> None:
    """Convert one file into another: its format (by the suffix of OUT), its framerate, its rig.

    Example: motionkit convert walk.bvh walk.glb --fps 60 --onto hero.glb
    """
    from motionkit.edit.convert import converted_motion
    from motionkit.edit.motions import OutputPaths, find_motions
    from motionkit.io.character import read_character

    rate = console.parse_rate(fps)
    options = console.read_options(console.parse_rate(source_fps, "--source-fps"), skeleton_map, up=up)
    sources, problems = find_motions([source], options, store or default_path("store"))
    character = None if onto is None else read_character(onto, console.read_options(None, skeleton_map))
    paths = OutputPaths(
        "converted",
        [source],
        len(sources),
        out=out,
        file_format=file_format,
        overwrite=overwrite,
        usual_suffix=None if character is None else character.suffix,
    )
    edit = partial(converted_motion, fps=rate, character=character)
    about = {"onto": None if onto is None else str(onto)}
    _edit_each("convert", sources, problems, edit, paths, as_json, about, rate)


def _edit_each(
    verb: str,
    sources: "Sequence[MotionSource]",
    problems: Sequence[FormatError],
    edit: "Callable[[LoadedMotion], EditedMotion]",
    paths: "OutputPaths",
    as_json: bool,
    about: Mapping[str, Any],
    fps: Fraction | None = None,
) -> None:
    """Write a file for every motion, and print its path, or JSON that begins with `about`.

    Exits with 1 if a motion cannot be read or edited; messages, warnings and remarks go to stderr.
    """
    from motionkit.edit.motions import edit_file

    failures = [(str(problem.path), console.of_source(str(problem), problem)) for problem in problems]
    console.print_failures(failures)
    done: list[dict[str, Any]] = []
    with console.progress() as show:
        for source in tracked(show, verb, sources, len(sources)):
            try:
                path, edited = edit_file(source, edit, paths, fps)
            except (MotionkitError, OSError) as error:
                failures.append((source.name, console.of_source(describe(error), error)))
                console.print_failures(failures[-1:])
                continue
            clip = {"clip": source.name, "file": str(path)}
            done.append({**clip, **edited.details, "warnings": list(edited.warnings)})
            for warning in edited.warnings:
                console.stderr.print(f"motionkit: warning: {source.name}: {warning}")
            if edited.remark:
                console.stderr.print(f"motionkit: {source.name}: {edited.remark}")
            if not as_json:
                console.stdout.print(str(path))
    if as_json:
        failed = [{"clip": name, "message": message} for name, message in failures]
        console.print_json({**about, "clips": done, "failed": failed})
    if failures:
        raise typer.Exit(1)
