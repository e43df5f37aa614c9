"""The options of `motionkit ingest`: their types and what the command line says of them."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Compat(StrEnum):
    """Whose frames are to be reproduced."""

    HUMANML3D_20FPS = "humanml3d-20fps"


class OnError(StrEnum):
    """What a bad file does."""

    SKIP = "skip"
    STOP = "stop"


Sources = Annotated[list[Path], typer.Argument(help="Files and folders of motions.", show_default=False)]
StorePath = Annotated[Path | None, typer.Option(help="Store to make or to add to.", show_default="./store")]
FormatName = Annotated[str, typer.Option(help="auto tells formats by name and content; or one format's name.")]
CaptionsTable = Annotated[
    Path | None, typer.Option(help="CSV with a column 'file' and any of caption, action, split, fps …")
]
Indexes = Annotated[
    list[Path] | None,
    typer.Option(
        help="Index of stretches of the source's files: HumanML3D's index.csv, TMR's annotations.json (KIT-ML), "
        "BABEL's train.json. May be given several times."
    ),
]
TextsFolder = Annotated[Path | None, typer.Option(help="Folder of the index's captions: 000000.txt …")]
SplitsFolder = Annotated[
    Path | None,
    typer.Option(
        help="Folder of the index's train.txt, val.txt, test.txt; by default the index's, or the one above --texts."
    ),
]
Mirrored = Annotated[bool, typer.Option("--mirrored", help="The index's mirrored sequences too, M000000 …")]
Published = Annotated[
    Compat | None,
    typer.Option(help="Of the index's stretches the frames that HumanML3D published, not every native one."),
]
GivenFps = Annotated[str | None, typer.Option(help="Framerate that replaces what files say: 120, 30000/1001.")]
FpsRules = Annotated[
    list[Path] | None,
    typer.Option(
        help="TOML of framerates that files state wrongly (docs/formats.md); goes before the shipped one. "
        "May be given several times."
    ),
]
UnitMetres = Annotated[float | None, typer.Option(help="Length of one file unit in metres: 0.01 for centimetres.")]
SkeletonMaps = Annotated[
    list[Path] | None,
    typer.Option(help="TOML that says how a rig becomes the 22 joints (docs/formats.md). May be given several times."),
]
BodyModels = Annotated[
    Path | None,
    typer.Option(
        help="Folder of your own SMPL, SMPL-H or SMPL-X models (.npz), for AMASS's joints "
        "(else MOTIONKIT_BODY_MODELS, else SMPL's mean shape).",
        show_default=False,
    ),
]
OnErrorChoice = Annotated[
    OnError,
    typer.Option(
        help="skip: good sequences are stored, bad ones are told, exit code 0. "
        "stop: the first bad one ends it, the store stays as it was, exit code 1."
    ),
]
Overwrite = Annotated[
    bool, typer.Option("--overwrite", help="Replace the store instead of adding to it, once all is read.")
]
Workers = Annotated[
    int | None,
    typer.Option(min=1, help="Processes that read; by default all cores, one for few files.", show_default=False),
]
EngineName = Annotated[
    str,
    typer.Option(help="local; ray: a Ray on this machine, or that of RAY_ADDRESS; ray://HOST:PORT: a Ray cluster."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print the summary as JSON.")]
