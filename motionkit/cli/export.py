"""`motionkit export`: a store's motions as files again."""

from collections import Counter
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from motionkit.cli.console import print_json, progress, stderr, stdout
from motionkit.cli.options import parse_rate, read_options
from motionkit.core.errors import UsageError
from motionkit.core.files import default_path
from motionkit.core.progress import task

if TYPE_CHECKING:
    from motionkit.edit.export import Export, ExportReport

MEGABYTE = 1e6
FORMATS = "bvh, amass, joints-npy, npz, csv, robot-csv, gltf, humanml3d, kit, parquet"
SHOWN_LEFT_OUT = 20
SHOWN_MISSING = 3


def export(
    out: Annotated[Path, typer.Argument(help="New or empty folder.", show_default=False)],
    format: Annotated[str | None, typer.Option(help=f"{FORMATS}.", show_default="bvh")] = None,
    store: Annotated[Path | None, typer.Option(help="Store to export from.", show_default="./store")] = None,
    where: Annotated[
        str | None, typer.Option(metavar="SQL", help="Condition over the table of sequences: \"split = 'test'\".")
    ] = None,
    fps: Annotated[
        str | None,
        typer.Option(
            help="Resample to this framerate. By default native; 20 for humanml3d, 12.5 for kit.", show_default=False
        ),
    ] = None,
    onto: Annotated[
        Path | None,
        typer.Option(help="A character's .bvh or .glb: its bones and names, its file.", show_default=False),
    ] = None,
    plant: Annotated[bool, typer.Option("--plant", help="With --onto: make sliding feet stand.")] = False,
    skeleton_map: Annotated[
        list[Path] | None, typer.Option(help="With --onto: TOML that says how its rig becomes the 22 joints.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print what was written as JSON.")] = False,
) -> None:
    """Write a store's motions as files for other tools, which `motionkit ingest` reads again.

    The folder appears once it is complete. Sequences that a format cannot represent are left out and reported.

    Example: motionkit export out --format npz --where "split = 'test'"
    """
    from motionkit.edit import export as exports
    from motionkit.store import Store

    rate = parse_rate(fps)
    if onto is None and (plant or skeleton_map):
        raise UsageError("--plant and --skeleton-map go with --onto; 'motionkit plant' plants any motion")
    kind = _kind(format) if onto is None else _character(onto, format, plant, skeleton_map)
    opened = Store.open(store or default_path("store"))
    selection = exports.Selection(opened, opened.select_some(where), rate or kind.fps)
    with progress() as show, task(show, "export", len(selection.indices)) as work:
        report = exports.export(selection, out, kind, on_outcome=lambda outcome: work.advance())
    _print_remarks(report, opened.path)
    if as_json:
        print_json(report.plain())
        return
    size = f"{report.num_files:,} files, {report.num_bytes / MEGABYTE:,.1f} MB"
    stdout.print(f"wrote {report.num_sequences:,} sequences to {report.folder}: {size}")
    if report.left_out:
        counts = Counter(outcome.reason for outcome in report.left_out).most_common()
        reasons = ", ".join(f"{count:,} {reason}" for reason, count in counts)
        stdout.print(f"left out: {len(report.left_out):,} ({reasons})")


def _kind(format: str | None) -> "Export":
    from motionkit.edit.export import export_kinds

    kinds = export_kinds()
    if (format or "bvh") not in kinds:
        raise UsageError(f"unknown format {format!r}, expected one of {', '.join(kinds)}")
    return kinds[format or "bvh"]


def _character(path: Path, format: str | None, plant: bool, skeleton_maps: list[Path] | None) -> "Export":
    from motionkit.edit.export import Export, export_files
    from motionkit.io.character import character_format, read_character

    character = read_character(path, read_options(None, skeleton_maps))
    if format not in (None, {".glb": "gltf"}.get(character.suffix, character.suffix[1:])):
        raise UsageError(f"--onto {path} writes files like it: leave --format {format} out")
    return Export(character.suffix[1:], partial(export_files, format=character_format(character, plant)))


def _print_remarks(report: "ExportReport", store: Path) -> None:
    """Print which sequences are left out, and what the others lack."""
    from motionkit.edit.export import MISSING

    for outcome in report.left_out[:SHOWN_LEFT_OUT]:
        stderr.print(f"left out {outcome.sequence_id}: {outcome.message}")
    if len(report.left_out) > SHOWN_LEFT_OUT:
        stderr.print(f"… and {len(report.left_out) - SHOWN_LEFT_OUT:,} more; --json lists all")
    for what, sequence_ids in report.missing.items():
        named = ", ".join(sequence_ids[:SHOWN_MISSING]) + (", …" if len(sequence_ids) > SHOWN_MISSING else "")
        message = MISSING[what].format(store=store)
        stderr.print(f"{len(sequence_ids):,} of {report.num_sequences:,} motions ({named}) are {message}")
