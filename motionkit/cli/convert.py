"""`motionkit convert`: one file into another, by format, framerate or rig."""

from pathlib import Path
from typing import Annotated

import typer

from motionkit.cli.each_clip import edit_each
from motionkit.cli.options import (
    AsJson,
    FormatChoice,
    Overwrite,
    SkeletonMaps,
    SourceFps,
    StorePath,
    Up,
    parse_rate,
    read_options,
)
from motionkit.core.files import default_path


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
    onto: Annotated[
        Path | None,
        typer.Option(help="A character's .bvh or .glb: its bones and names, its file.", show_default=False),
    ] = None,
    up: Up = None,
    file_format: FormatChoice = None,
    overwrite: Overwrite = False,
    source_fps: SourceFps = None,
    skeleton_map: SkeletonMaps = None,
    store: StorePath = None,
    as_json: AsJson = False,
) -> None:
    """Convert one file into another: its format (by the suffix of OUT), its framerate, its rig.

    Example: motionkit convert walk.bvh walk.glb --fps 60 --onto hero.glb
    """
    from motionkit.edit.convert import convert_file
    from motionkit.edit.motions import OutputPaths, find_motions
    from motionkit.io.character import read_character

    rate = parse_rate(fps)
    options = read_options(parse_rate(source_fps, "--source-fps"), skeleton_map, up=up)
    sources, problems = find_motions([source], options, store or default_path("store"))
    paths = OutputPaths("converted", [source], len(sources), out=out, file_format=file_format, overwrite=overwrite)
    character = None if onto is None else read_character(onto, read_options(None, skeleton_map))
    edit_each(
        *("convert", sources, problems),
        lambda each: convert_file(each, rate, character, paths),
        as_json,
        {"onto": None if onto is None else str(onto)},
    )
