"""`motionkit plant`: remove foot sliding."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from motionkit.cli.complete import FormatChoice, Overwrite, SkeletonMaps, SourceFps, StorePath
from motionkit.cli.each_clip import write_each
from motionkit.cli.options import parse_rate, read_options
from motionkit.core.errors import UsageError
from motionkit.core.settings import default_path


class BodyPath(StrEnum):
    """How the body's path is treated."""

    NEAR = "near"
    FREE = "free"


Clips = Annotated[
    list[str] | None, typer.Argument(help="Files, folders, or ids of stored sequences.", show_default=False)
]
Where = Annotated[
    str | None, typer.Option(metavar="SQL", help="Stored sequences that satisfy this condition: \"action = 'walk'\".")
]
PathOfBody = Annotated[
    BodyPath, typer.Option("--path", help="Keep the body near its own path, or let the standing feet carry it.")
]
OutPlace = Annotated[
    Path | None, typer.Option(help="File, or folder for several clips.", show_default="NAME.planted.EXT beside each")
]
Page = Annotated[bool, typer.Option("--page", help="Also write an HTML page with both skeletons, before and after.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print what was written, and how much was moved, as JSON.")]


if TYPE_CHECKING:
    from motionkit.edit.plant.job import PlantedClip
    from motionkit.edit.plant.report import Change

SMALL_METRES = 0.001


def plant(
    clips: Clips = None,
    where: Where = None,
    path: PathOfBody = BodyPath.NEAR,
    out: OutPlace = None,
    file_format: FormatChoice = None,
    page: Page = False,
    overwrite: Overwrite = False,
    source_fps: SourceFps = None,
    skeleton_map: SkeletonMaps = None,
    store: StorePath = None,
    as_json: AsJson = False,
) -> None:
    """Make sliding feet stand, in captures and in anybody's samples; bones keep their length.

    With --store and no clip, all sequences of the store (or those of --where), into --out.

    Example: motionkit plant takes/walk.bvh --page
    """
    from motionkit.edit.complete.clips import clip_of_motion, find_clips
    from motionkit.edit.complete.job import OutputPath
    from motionkit.edit.export.files import output_suffix
    from motionkit.edit.plant.job import Job
    from motionkit.io.scan import PLANTED
    from motionkit.store.named_motions.reading import find_stored

    place = store or default_path("store")
    options = read_options(parse_rate(source_fps, "--source-fps"), skeleton_map)
    if not clips and (out is None or (store is None and where is None)):
        raise UsageError("name clips or folders; or a store (--store) and a folder for its sequences (--out)")
    sources, problems = find_clips(clips or [], options, place)
    if where is not None or not clips:
        sources += find_stored(place, where or "true", clip_of_motion)
    folders = [Path(each) for each in clips or () if Path(each).is_dir()]
    several = len(sources) > 1 or bool(folders) or not clips
    job = Job(path.value, page, output_suffix(out, file_format, several=several), overwrite)
    path_of = OutputPath(out, len(sources), folders, PLANTED)
    write_each(
        "plant",
        (sources, problems),
        lambda source, on_frames: job.plant(source, path_of, on_frames),
        _remarks,
        {"path": path.value} if as_json else None,
    )


def _remarks(planted: "PlantedClip") -> list[str]:
    notes = [f"warning: {planted.source}: {planted.note}"] if planted.note else []
    return [*notes, f"{planted.source}: {_described(planted.change)}"]


def _described(change: "Change") -> str:
    """What was changed, and why."""
    if change.sliding_before is None or change.sliding_after is None:
        described = "no foot is on the ground"
    elif change.largest_level_shift < SMALL_METRES:
        described = f"feet slide no more than captures do ({100 * change.sliding_before:.1f} cm/s): left alone"
    else:
        described = (
            f"{change.num_contacts:,} contacts slid at {100 * change.sliding_before:.1f} cm/s, now "
            f"{100 * change.sliding_after:.1f}"
        )
    if change.largest_height_shift >= SMALL_METRES:
        described += f"; feet were up to {1000 * change.largest_height_shift:.0f} mm above or below the ground"
    if change.has_fixed_bones:
        described += "; bones changed their length"
    if change.largest_change >= SMALL_METRES:
        described += f"; joints moved by up to {1000 * change.largest_change:.0f} mm"
    return described
