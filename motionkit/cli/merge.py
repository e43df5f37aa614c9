"""`motionkit merge`: stores, or a selection of their sequences, into one."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from motionkit.cli.console import print_json, progress, stderr, stdout
from motionkit.core.progress import task

if TYPE_CHECKING:
    from motionkit.store.life.rewrite import MergeReport


class OnConflict(StrEnum):
    """What to do if one id stands for two different files."""

    STOP = "stop"
    SKIP = "skip"


def merge(
    out: Annotated[Path, typer.Argument(help="Store to make or to add to.", show_default=False)],
    sources: Annotated[list[Path], typer.Argument(help="Stores to copy from.", show_default=False)],
    where: Annotated[
        str | None,
        typer.Option(metavar="SQL", help="Condition over each source's table of sequences: \"split = 'test'\"."),
    ] = None,
    on_conflict: Annotated[
        OnConflict, typer.Option(help="One id, two files: write nothing, or keep the first.")
    ] = OnConflict.STOP,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON.")] = False,
) -> None:
    """Copy stores into one, or a subset of a store into a new one, unchanged.

    Sequences that the target has from equal files are kept.

    Example: motionkit merge tests store --where "split = 'test'"
    """
    from motionkit.store.life.rewrite import merge as merge_stores

    with progress() as show, task(show, "merge") as work:
        report = merge_stores(
            out,
            sources,
            where=where,
            on_conflict=on_conflict.value,
            on_start=work.set_total,
            on_sequence=work.advance,
        )
    for sequence_id in report.conflicts:
        stderr.print(f"left out: {sequence_id!r} is there from another file")
    _print(report, as_json)


def _print(report: "MergeReport", as_json: bool) -> None:
    if as_json:
        print_json(
            {
                "store": str(report.store),
                "stored": report.num_stored,
                "already_stored": report.num_already_stored,
                "conflicts": report.conflicts,
                "sequences_in_store": report.num_in_store,
            }
        )
        return
    stdout.print(f"stored {report.num_stored:,} sequences in {report.store}, which holds {report.num_in_store:,}")
    if report.num_already_stored:
        stdout.print(f"already there: {report.num_already_stored:,}")
    if report.conflicts:
        stdout.print(f"left out: {len(report.conflicts):,} whose ids are there from other files")
