"""The options of `motionkit complete`: their types and what the command line says of them."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

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
