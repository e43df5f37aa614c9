"""The options of `motionkit view`: their types and what the command line says of them."""

from pathlib import Path
from typing import Annotated

import typer

from motionkit.viewing import MOST_MOTIONS

Clips = Annotated[
    list[str] | None, typer.Argument(help="Files, folders, or ids of stored sequences.", show_default=False)
]
StorePath = Annotated[Path | None, typer.Option(help="Store of sequence ids.", show_default="./store")]
Where = Annotated[
    str | None, typer.Option(metavar="SQL", help="Stored sequences for which this holds: \"action = 'walk'\".")
]
Limit = Annotated[int, typer.Option(min=1, max=MOST_MOTIONS, help="Motions in the page; of more, the first are shown.")]
FromSeconds = Annotated[
    float | None, typer.Option("--from", metavar="SECONDS", help="Show what comes from here on.", show_default=False)
]
ToSeconds = Annotated[
    float | None, typer.Option("--to", metavar="SECONDS", help="Show what comes before this.", show_default=False)
]
GivenFps = Annotated[
    str | None, typer.Option(help="Framerate of files that say none or a wrong one (.amc, .npy).", show_default=False)
]
UnitMetres = Annotated[
    float | None,
    typer.Option(help="Length of one file unit in metres: 0.01 for centimetres.", show_default=False),
]
FormatName = Annotated[str, typer.Option(help="auto tells formats by name and content; or one format's name.")]
SkeletonMaps = Annotated[
    list[Path] | None, typer.Option(help="TOML that says how a rig becomes the 22 joints (docs/formats.md).")
]
OutPlace = Annotated[Path | None, typer.Option(help="The page's file.", show_default="NAME.view.html here")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace the page if it exists.")]
OpenPage = Annotated[bool, typer.Option("--open", help="Open the page in the browser.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print what was written as JSON.")]
