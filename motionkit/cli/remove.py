"""`motionkit remove`: remove sequences from a store."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from motionkit.cli.console import print_json, stdout
from motionkit.core.errors import UsageError
from motionkit.core.files import default_path

if TYPE_CHECKING:
    from motionkit.store.life.rewrite import Removal

MEGABYTE = 1e6
SHOWN_IDS = 20


def remove(
    ids: Annotated[list[str] | None, typer.Argument(help="Ids of sequences.", show_default=False)] = None,
    where: Annotated[
        str | None, typer.Option(metavar="SQL", help="Condition over the table of sequences: \"source = 'CMU'\".")
    ] = None,
    store: Annotated[Path | None, typer.Option(help="Store to remove from.", show_default="./store")] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would go, and leave the store.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the removed ids as JSON.")] = False,
) -> None:
    """Remove sequences from a store, by id or by a condition.

    They disappear from its tables at once; their frames are deleted by 'motionkit compact'. To undo it, run 'motionkit
    ingest' on the same sources, which stores missing sequences, and 'motionkit split' again; or make a copy beforehand
    with 'motionkit merge COPY STORE'.

    Example: motionkit remove --where "duration_seconds > 1" --dry-run
    """
    from motionkit.store.commit import read_manifest
    from motionkit.store.life.rewrite import plan_removal
    from motionkit.store.life.rewrite import remove as remove_sequences

    if not ids and where is None:
        raise UsageError("name the sequences to remove, by their ids or with --where")
    path = store or default_path("store")
    if dry_run:
        _say_plan(path, plan_removal(path, ids or (), where=where), where, as_json)
        return
    removed = remove_sequences(path, ids or (), where=where)
    if not removed:
        raise UsageError(f"no sequence of {path} satisfies {where!r}")
    manifest = read_manifest(path)
    if as_json:
        print_json(
            {
                "store": str(path),
                "removed": removed,
                "sequences_in_store": manifest.num_sequences,
                "sequences_to_compact": manifest.num_removed,
            }
        )
        return
    stdout.print(f"removed {len(removed):,} sequences from {path}, which holds {manifest.num_sequences:,}")
    if manifest.num_removed:
        stdout.print(f"their frames leave the disk with 'motionkit compact --store {path}'")


def _say_plan(path: Path, plan: "Removal", where: str | None, as_json: bool) -> None:
    if not plan.sequence_ids:
        raise UsageError(f"no sequence of {path} satisfies {where!r}")
    if as_json:
        sizes = {"bytes_at_once": plan.bytes_at_once, "bytes_with_compact": plan.bytes_later}
        print_json({"store": str(path), "dry_run": True, "would_remove": plan.sequence_ids, **sizes})
        return
    for sequence_id in plan.sequence_ids[:SHOWN_IDS]:
        stdout.print(f"  {sequence_id}")
    left_out = len(plan.sequence_ids) - SHOWN_IDS
    if left_out > 0:
        stdout.print(f"  and {left_out:,} more: --json names all")
    stdout.print(
        f"would remove {len(plan.sequence_ids):,} sequences from {path}: about {plan.bytes_at_once / MEGABYTE:,.1f} MB "
        f"at once, {plan.bytes_later / MEGABYTE:,.1f} MB with 'motionkit compact'"
    )
