"""`motionkit complete`: a motion at any framerate, its gaps closed, its ends continued."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from motionkit.cli.console import stderr
from motionkit.cli.each_clip import write_each
from motionkit.cli.options import parse_rate, read_options
from motionkit.core.settings import default_path
from motionkit.training.loaders import loader_names


class ClipFormat(StrEnum):
    """Output formats other than the clip's own."""

    BVH = "bvh"
    CSV = "csv"
    GLB = "glb"
    NPZ = "npz"


Clips = Annotated[list[str], typer.Argument(help="Files, folders, or ids of stored sequences.", show_default=False)]
TargetFps = Annotated[
    str | None, typer.Option(help="New framerate, any: 120, 23.976, 60000/1001.", show_default="the clip's own")
]
KeptFrames = Annotated[
    str | None,
    typer.Option(metavar="A:B,…", help="Frames to keep, [A, B) counted from 0; all others are replaced."),
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
    ClipFormat | None, typer.Option("--format", help="Format of the files.", show_default="--out's, or the clip's own")
]
Plant = Annotated[bool, typer.Option("--plant", help="Make sliding feet stand, in what is made.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace files that exist.")]
ComparedNames = Annotated[
    str | None,
    typer.Option(metavar="NAME,…", help="Also write an HTML page with moving skeletons: slerp,spline."),
]
SourceFps = Annotated[
    str | None, typer.Option(help="Framerate of clips whose files state none or a wrong one (.amc, .npy).")
]
SkeletonMaps = Annotated[
    list[Path] | None, typer.Option(help="TOML that maps a rig to the 22 joints (docs/formats.md).")
]
StorePath = Annotated[Path | None, typer.Option(help="Store of sequence ids.", show_default="./store")]
AsJson = Annotated[bool, typer.Option("--json", help="Print what was written as JSON.")]


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
    """Complete clips: a higher framerate, gaps filled, ends continued; given frames and bone lengths are kept.

    Example: motionkit complete takes/walk.bvh --fps 120 --model cubic
    """
    from motionkit.edit.complete.request import CompletionRequest, Reach, parse_extend, parse_keep

    before, after = parse_extend(extend) if extend else (Reach(0.0), Reach(0.0))
    request = CompletionRequest(
        fps=parse_rate(fps),
        keep=parse_keep(keep) if keep else (),
        before=before,
        after=after,
        plant=plant,
    )
    from motionkit.edit.complete.clips import find_clips
    from motionkit.edit.complete.encoders import choose_encoder
    from motionkit.edit.complete.job import Job, OutputPath
    from motionkit.edit.export.files import output_suffix

    options = read_options(parse_rate(source_fps, "--source-fps"), skeleton_map)
    sources, problems = find_clips(clips, options, store or default_path("store"))
    folders = [Path(each) for each in clips if Path(each).is_dir()]
    suffix = output_suffix(out, file_format, several=len(sources) > 1 or bool(folders))
    runs_folder = runs or default_path("runs")
    chosen = choose_encoder(model, run, runs_folder)
    compared = [choose_encoder(name.strip(), None, runs_folder) for name in compare.split(",")] if compare else []
    stderr.print(f"motionkit: completing with {chosen.explanation}")
    job = Job(request, chosen, compared, suffix, overwrite=overwrite)
    path_of = OutputPath(out, len(sources), folders)
    write_each(
        "complete",
        (sources, problems),
        lambda source, on_frames: job.complete(source, path_of, on_frames),
        lambda done: [f"warning: {done.source}: {warning}" for warning in done.warnings],
        {"encoder": chosen.name} if as_json else None,
    )
