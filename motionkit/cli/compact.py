"""`motionkit compact`: rewrite a store with few full parts."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from motionkit.cli.console import print_json, progress, stdout
from motionkit.core.files import default_path
from motionkit.core.progress import task

if TYPE_CHECKING:
    from motionkit.store.life.rewrite import Compaction

MEGABYTE = 1e6


def compact(
    store: Annotated[Path | None, typer.Option(help="Store to compact.", show_default="./store")] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be done, and leave the store.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print what was done as JSON.")] = False,
) -> None:
    """Rewrite a store's parts, full and without removed sequences; if interrupted, the store is unchanged.

    Sequences are renumbered from 0. Needs disk space for a second copy until it is done; programs that have the store
    open must reopen it. Removed sequences can then only be restored from their sources or a copy of the store. The
    store's fingerprint changes, so its training caches are rebuilt.

    Example: motionkit compact --dry-run
    """
    from motionkit.store.commit import leftovers, read_manifest
    from motionkit.store.life.rewrite import compact as compact_store
    from motionkit.store.life.rewrite import plan_compaction

    path = store or default_path("store")
    if dry_run:
        _say_plan(path, plan_compaction(path), as_json)
        return
    before = read_manifest(path)
    num_left = len(leftovers(path, before))
    with progress() as show, task(show, "compact", before.num_sequences) as work:
        changed = compact_store(path, work.advance)
    after = read_manifest(path)
    if as_json:
        print_json(
            {
                "store": str(path),
                "parts_before": len(before.parts),
                "parts": len(after.parts),
                "bytes_before": before.num_bytes,
                "bytes": after.num_bytes,
                "leftovers_deleted": num_left,
            }
        )
        return
    if num_left:
        stdout.print(f"{path}: deleted {num_left:,} files that a stopped command had left")
    if changed:
        stdout.print(
            f"{path}: {len(before.parts):,} parts, {before.num_bytes / MEGABYTE:,.1f} MB, became {len(after.parts):,}, "
            f"{after.num_bytes / MEGABYTE:,.1f} MB",
        )
    else:
        stdout.print(f"{path} is compact already")


def _say_plan(path: Path, plan: "Compaction", as_json: bool) -> None:
    if as_json:
        print_json({"store": str(path), "dry_run": True, **asdict(plan)})
    elif plan.is_compact:
        stdout.print(f"{path} is compact already")
    else:
        stdout.print(
            f"{path}: {plan.num_parts:,} parts, {plan.num_bytes / MEGABYTE:,.1f} MB, would become about "
            f"{plan.bytes_after / MEGABYTE:,.1f} MB; the frames of {plan.num_removed:,} removed sequences would "
            f"be gone for good; until it is done both need room"
        )
