"""Parsing of options that several commands share: framerates, and how files are read."""

import re
import shlex
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from motionkit.core.errors import FormatError, UsageError

if TYPE_CHECKING:
    from motionkit.io.registry import ReadOptions


Axis = Literal["x", "y", "z"]

# Options of several commands.
Up = Annotated[
    Axis | None,
    typer.Option(help="The files' axis that points up; by default inferred from the motion.", show_default=False),
]
Clips = Annotated[
    list[str] | None, typer.Argument(help="Files, folders, or ids of stored sequences.", show_default=False)
]
Where = Annotated[
    str | None, typer.Option(metavar="SQL", help="Stored sequences that satisfy this condition: \"action = 'walk'\".")
]
FileFormat = Annotated[
    Literal["bvh", "csv", "glb", "npz"] | None,
    typer.Option("--format", help="Format of the files.", show_default="--out's, or the clip's own"),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace files that exist.")]
SourceFps = Annotated[
    str | None, typer.Option(help="Framerate of clips whose files state none or a wrong one (.amc, .npy).")
]
SkeletonMaps = Annotated[
    list[Path] | None, typer.Option(help="TOML that maps a rig to the 22 joints (docs/formats.md).")
]
Onto = Annotated[
    Path | None, typer.Option(help="A character's .bvh or .glb: its bones and names, its file.", show_default=False)
]
RunsFolder = Annotated[Path | None, typer.Option(help="Folder of all runs.", show_default="./runs")]
StorePath = Annotated[Path | None, typer.Option(help="Store of sequence ids.", show_default="./store")]
AsJson = Annotated[bool, typer.Option("--json", help="Print what was done as JSON.")]
StoreArgument = Annotated[
    Path | None, typer.Argument(metavar="STORE", help="The store, as with --store.", show_default=False)
]


def named_store(argument: Path | None, option: Path | None) -> Path | None:
    """The store named by position or by --store, None for the default; raises `UsageError` for both."""
    if argument is not None and option is not None:
        raise UsageError(f"two stores, {argument} and --store {option}: name one")
    return argument or option


def of_default(option: str, given: Path | None) -> str:
    """An option as text for a suggested command; empty for the default."""
    return "" if given is None else f" {option} {shlex.quote(str(given))}"


def parse_rate(text: str | None, option: str = "--fps") -> Fraction | None:
    """Parse an option's framerate; raises `UsageError` that names the option."""
    from motionkit.core.timegrid import parse_fps  # deferred: numpy

    try:
        return None if text is None else parse_fps(text)
    except ValueError as error:
        raise UsageError(f"{option} {text}: {error}") from None


def parse_duration(text: str, option: str) -> float:
    """Seconds of "90s", "20m" or "1.5h"; raises `UsageError` that names the option."""
    found = re.fullmatch(r"(\d+(?:\.\d+)?)(s|m|h)", text)
    if found is None or not float(found[1]):
        raise UsageError(f"{option} {text}: a number above 0 with its unit, such as 90s, 20m or 1.5h")
    return float(found[1]) * {"s": 1.0, "m": 60.0, "h": 3600.0}[found[2]]


def of_source(message: str, error: Exception) -> str:
    """A reader's error for commands in which `--fps` is the new framerate and `--source-fps` that of the file."""
    return re.sub(r"--fps\b(?!-)", "--source-fps", message) if isinstance(error, FormatError) else message


def read_options(
    fps: Fraction | None,
    skeleton_maps: Sequence[Path] | None,
    format: str = "auto",
    unit_metres: float | None = None,
    captions: Path | None = None,
    up: Axis | None = None,
    skip_derived: bool = False,
) -> "ReadOptions":
    """The options of readers; raises `UsageError` for a unit that is not a positive length."""
    from motionkit.core.skeletons.mapping import read_skeleton_map
    from motionkit.io.registry import ReadOptions

    if unit_metres is not None and not 0 < unit_metres < float("inf"):
        raise UsageError(f"--unit-metres must be a positive number, not {unit_metres}")
    maps = tuple(map(read_skeleton_map, skeleton_maps or ()))
    return ReadOptions(
        format=format,
        fps=fps,
        unit_metres=unit_metres,
        up=up or "",
        captions=captions,
        skeleton_maps=maps,
        skip_derived=skip_derived,
    )
