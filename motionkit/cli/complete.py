"""`motionkit complete`: a motion at any framerate, its gaps closed, its ends continued."""

from pathlib import Path
from typing import Annotated

import typer

from motionkit.cli.console import stderr
from motionkit.cli.each_clip import edit_each
from motionkit.cli.options import (
    AsJson,
    FormatChoice,
    Overwrite,
    SkeletonMaps,
    SourceFps,
    StorePath,
    parse_rate,
    read_options,
)
from motionkit.core import plugins
from motionkit.core.files import default_path

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
        str | None,
        typer.Option(metavar="BEFORE,AFTER", help="Seconds to add before and after, or frames of the clip: 0,15f."),
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
    runs: Annotated[Path | None, typer.Option(help="Folder of all runs.", show_default="./runs")] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="File, or folder for several clips.", show_default="NAME.completed.EXT beside each"),
    ] = None,
    file_format: FormatChoice = None,
    overwrite: Overwrite = False,
    compare: Annotated[
        str | None,
        typer.Option(metavar="NAME,…", help="Also write an HTML page with moving skeletons: slerp,spline."),
    ] = None,
    source_fps: SourceFps = None,
    skeleton_map: SkeletonMaps = None,
    store: StorePath = None,
    as_json: AsJson = False,
) -> None:
    """Complete clips: a higher framerate, gaps filled, ends continued; given frames and bone lengths are kept.

    Example: motionkit complete takes/walk.bvh --fps 120 --model cubic
    """
    from motionkit.edit.complete import CompletionRequest, complete_file, parse_extend, parse_keep
    from motionkit.edit.encoders import choose_encoder
    from motionkit.edit.motions import OutputPaths, find_motions
    from motionkit.io.scan import COMPLETED

    before, after = parse_extend(extend or "0")
    request = CompletionRequest(parse_rate(fps), parse_keep(keep) if keep else None, before, after, plant)
    options = read_options(parse_rate(source_fps, "--source-fps"), skeleton_map, skip_derived=True)
    sources, problems = find_motions(clips, options, store or default_path("store"))
    paths = OutputPaths(COMPLETED, clips, len(sources), out=out, file_format=file_format, overwrite=overwrite)
    runs_folder = runs or default_path("runs")
    chosen = choose_encoder(model, run, runs_folder)
    compared = [choose_encoder(name.strip(), None, runs_folder) for name in compare.split(",")] if compare else []
    stderr.print(f"motionkit: completing with {chosen.explanation}")
    edit_each(
        *("complete", sources, problems),
        lambda source: complete_file(source, request, chosen, compared, paths),
        as_json,
        {"encoder": chosen.name},
    )
