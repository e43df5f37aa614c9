"""`motionkit export`: a store's motions as files again."""

from collections import Counter
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from motionkit.cli import console
from motionkit.core.errors import UsageError, counted
from motionkit.core.files import default_path
from motionkit.core.progress import task

FORMATS = "bvh, amass, joints-npy, npz, csv, robot-csv, gltf, humanml3d, kit, parquet"
SHOWN_LEFT_OUT = 20


def export(
    out: Annotated[Path, typer.Argument(help="Folder to write.", show_default=False)],
    format: Annotated[str | None, typer.Option(help=f"{FORMATS}.", show_default="bvh")] = None,
    store: Annotated[Path | None, typer.Option(help="Store to export from.", show_default="./store")] = None,
    where: console.Where = None,
    fps: Annotated[
        str | None,
        typer.Option(
            help="Resample to this framerate. By default native; 20 for humanml3d, 12.5 for kit.", show_default=False
        ),
    ] = None,
    onto: console.Onto = None,
    plant: Annotated[bool, typer.Option("--plant", help="With --onto: make sliding feet stand.")] = False,
    skeleton_map: Annotated[
        list[Path] | None, typer.Option(help="With --onto: TOML that says how its rig becomes the 22 joints.")
    ] = None,
    overwrite: console.Overwrite = False,
    as_json: console.AsJson = False,
) -> None:
    """Write a store's motions as files for other tools, which `motionkit ingest` reads again.

    The folder appears once it is complete. Sequences that a format cannot represent are left out and reported.

    Example: motionkit export out --format npz --where "split = 'test'"
    """
    from motionkit.edit import export as exports
    from motionkit.store import Store

    rate, kinds = console.parse_rate(fps), exports.export_kinds()
    if onto is not None:
        from motionkit.io.character import character_format, read_character

        if format is not None:
            raise UsageError("--onto writes files like its own: leave --format out")
        character = read_character(onto, console.read_options(None, skeleton_map))
        write = partial(exports.export_files, format=character_format(character, plant))
        kind = exports.Export(character.suffix[1:], write)
    elif plant or skeleton_map:
        raise UsageError("--plant and --skeleton-map go with --onto; 'motionkit plant' plants any motion")
    elif (format or "bvh") not in kinds:
        raise UsageError(f"unknown format {format!r}, expected one of {', '.join(kinds)}")
    else:
        kind = kinds[format or "bvh"]
    opened = Store.open(store or default_path("store"))
    selection = exports.Selection(opened, opened.select_some(where), rate or kind.fps)
    with console.progress() as show, task(show, "export", len(selection.indices)) as work:
        report = exports.export(selection, out, kind, lambda outcome: work.advance(), overwrite=overwrite)
    for outcome in report.left_out[:SHOWN_LEFT_OUT]:
        console.stderr.print(f"left out {outcome.sequence_id}: {outcome.message}")
    if len(report.left_out) > SHOWN_LEFT_OUT:
        console.stderr.print(f"… and {len(report.left_out) - SHOWN_LEFT_OUT:,} more; --json lists all")
    if as_json:
        console.print_json({**asdict(report), "folder": str(report.folder)})
        return
    size = f"{counted(report.num_files, 'file')}, {report.num_bytes / 1e6:,.1f} MB"
    console.stdout.print(f"wrote {counted(report.num_sequences, 'sequence')} to {report.folder}: {size}")
    if report.left_out:
        counts = Counter(outcome.reason for outcome in report.left_out).most_common()
        reasons = ", ".join(f"{count:,} {reason}" for reason, count in counts)
        console.stdout.print(f"left out: {len(report.left_out):,} ({reasons})")
