"""`motionkit plant`: remove foot sliding."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from motionkit.cli.each_clip import edit_each
from motionkit.cli.options import (
    Clips,
    FormatChoice,
    Overwrite,
    SkeletonMaps,
    SourceFps,
    StorePath,
    WhereOption,
    parse_rate,
    read_options,
)
from motionkit.core.errors import UsageError
from motionkit.core.files import default_path


class BodyPath(StrEnum):
    """How the body's path is treated."""

    NEAR = "near"
    FREE = "free"


def plant(
    clips: Clips = None,
    where: WhereOption = None,
    path: Annotated[
        BodyPath, typer.Option("--path", help="Keep the body near its own path, or let the standing feet carry it.")
    ] = BodyPath.NEAR,
    out: Annotated[
        Path | None,
        typer.Option(help="File, or folder for several clips.", show_default="NAME.planted.EXT beside each"),
    ] = None,
    file_format: FormatChoice = None,
    page: Annotated[
        bool, typer.Option("--page", help="Also write an HTML page with both skeletons, before and after.")
    ] = False,
    overwrite: Overwrite = False,
    source_fps: SourceFps = None,
    skeleton_map: SkeletonMaps = None,
    store: StorePath = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print what was written, and how much was moved, as JSON.")
    ] = False,
) -> None:
    """Make sliding feet stand, in captures and in anybody's samples; bones keep their length.

    With --store and no clip, all sequences of the store (or those of --where), into --out.

    Example: motionkit plant takes/walk.bvh --page
    """
    from motionkit.edit.motions import OutputPaths, find_motions
    from motionkit.edit.plant import plant_file
    from motionkit.io.scan import PLANTED

    if not clips and (out is None or (store is None and where is None)):
        raise UsageError("name clips or folders; or a store (--store) and a folder for its sequences (--out)")
    options = read_options(parse_rate(source_fps, "--source-fps"), skeleton_map, skip_derived=True)
    where = where if clips else where or "true"
    sources, problems = find_motions(clips or (), options, store or default_path("store"), where)
    paths = OutputPaths(PLANTED, clips or (), len(sources), out=out, file_format=file_format, overwrite=overwrite)
    edit_each(
        *("plant", sources, problems),
        lambda source: plant_file(source, path.value, page, paths),
        as_json,
        {"path": path.value},
    )
