"""Commands that check and change a store: validate, split, remove, merge, compact."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from motionkit.cli import console
from motionkit.core.errors import UsageError, counted, lasting
from motionkit.core.files import default_path
from motionkit.core.progress import task

MEGABYTE = 1e6
SHOWN_IDS = 20

ChangedStore = Annotated[Path | None, typer.Option(help="Store to change.", show_default="./store")]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Say what would be done, and leave the store.")]


def validate(
    path: console.StoreArgument = None,
    store: Annotated[Path | None, typer.Option(help="Store to check.", show_default="./store")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the faults as JSON.")] = False,
) -> None:
    """Check every file of a store: checksums, tables, finite frames.

    Prints a line for each fault. Exit code 1 if there is any, else 0.

    Example: motionkit validate
    """
    from motionkit.store.commit import read_manifest
    from motionkit.store.validate import faults

    path = console.named_store(path, store) or default_path("store")
    manifest = read_manifest(path)
    with console.progress() as show, task(show, "validate", len(manifest.files)) as work:
        found = list(faults(path, lambda name: work.advance()))
    if as_json:
        console.print_json({"store": str(path), "fingerprint": manifest.fingerprint, "faults": found})
    else:
        intact = (
            f"{path} is intact: {counted(manifest.num_sequences, 'sequence')}, {counted(len(manifest.files), 'file')}"
        )
        for line in found or [intact]:
            console.stdout.print(line)
    if found:
        raise typer.Exit(1)


def split(
    path: console.StoreArgument = None,
    shares: Annotated[
        str, typer.Option(help="What part of the motion, in seconds, each split gets: test=1 puts all of it there.")
    ] = "train=0.8,val=0.05,test=0.15",
    by: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SQL",
            help="What stays together: performer (source and subject), wording (captions of the same words), source, "
            "source_path, or any expression over the table of sequences; sequence_id to hold out takes of known "
            "performers. Given again, what shares either stays together: --by performer --by wording.",
            show_default="performer",
        ),
    ] = None,
    where: Annotated[
        str | None,
        typer.Option(metavar="SQL", help="Only sequences for which this holds; the others stay where they are."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Who is held out follows from it.")] = 0,
    unseen_wordings: Annotated[
        bool,
        typer.Option("--unseen-wordings", help="Remove captions of train whose words are said in val or test too."),
    ] = False,
    store: ChangedStore = None,
    dry_run: DryRun = False,
    as_json: console.AsJson = False,
) -> None:
    """Split a store into train, val and test so that held-out performers are not in training.

    The sources' own splits are replaced. The store's fingerprint changes, and runs trained on it no longer match:
    split before training, or split a copy ('motionkit merge').

    Example: motionkit split --by sequence_id --shares train=0.6,test=0.4
    """
    from motionkit.store.life import PERFORMER
    from motionkit.store.life import split as split_store

    store = console.named_store(path, store)
    place, requested = store or default_path("store"), parse_shares(shares)
    report = split_store(
        place, requested, by=by or [PERFORMER], where=where, seed=seed, unseen_wordings=unseen_wordings, dry_run=dry_run
    )
    if as_json:
        console.print_json({**asdict(report), "store": str(report.store), "seed": seed, "dry_run": dry_run})
        return
    console.stdout.print(
        f"{'split':8}{'share':>8}{'asked':>8}{'length':>10}{'groups':>10}{'sequences':>12}{'wordings seen':>16}"
    )
    for each in report.splits:
        length, seen = lasting(each.duration_seconds), f"{each.num_seen:,} of {each.num_captioned:,}"
        console.stdout.print(
            f"{each.split:8}{each.share:8.3f}{each.requested_share:8.3f}{length:>10}{each.num_groups:10,}"
            f"{each.num_sequences:12,}{seen:>16}",
        )
    doing = "would change" if dry_run else "changed"
    console.stdout.print(
        f"{doing} the split of {counted(report.num_changed, 'sequence')} of {report.store}, by {report.by}"
    )
    if unseen_wordings:
        doing = "would remove" if dry_run else "removed"
        console.stdout.print(
            f"{doing} {counted(report.num_captions_removed, 'caption')} of train whose words val or test has"
        )
    if not dry_run:
        console.stdout.print(f"next: motionkit train{console.of_default('--store', store)}")


def parse_shares(text: str) -> dict[str, float]:
    """Parse `train=0.8,test=0.2`; raises `UsageError` for anything else."""
    shares: dict[str, float] = {}
    for item in text.split(","):
        name, equals, number = (piece.strip() for piece in item.partition("="))
        try:
            share = float(number)
        except ValueError:
            share = float("nan")
        if not equals or share != share:
            raise UsageError(f"--shares takes SPLIT=NUMBER,… (train=0.8,val=0.05,test=0.15), not {text!r}")
        if name in shares:
            raise UsageError(f"--shares names {name!r} twice: {text!r}")
        shares[name] = share
    return shares


def remove(
    ids: Annotated[list[str] | None, typer.Argument(help="Ids of sequences.", show_default=False)] = None,
    where: console.Where = None,
    store: ChangedStore = None,
    dry_run: DryRun = False,
    as_json: console.AsJson = False,
) -> None:
    """Remove sequences from a store, by id or by a condition.

    They disappear from its tables at once; their frames are deleted by 'motionkit compact'. To undo it, run 'motionkit
    ingest' on the same sources, which stores missing sequences, and 'motionkit split' again; or make a copy beforehand
    with 'motionkit merge COPY STORE'.

    Example: motionkit remove --where "duration_seconds > 1" --dry-run
    """
    from motionkit.store.commit import read_manifest
    from motionkit.store.life import remove as remove_sequences

    if not ids and where is None:
        raise UsageError("name the sequences to remove, by their ids or with --where")
    path = store or default_path("store")
    # Also where nothing is left to remove: it finishes what a killed removal has left.
    removed = remove_sequences(path, ids or (), where=where, dry_run=dry_run)
    if not removed:
        raise UsageError(f"no sequence of {path} satisfies {where!r}")
    if dry_run:
        if as_json:
            console.print_json({"store": str(path), "dry_run": True, "would_remove": removed})
            return
        for sequence_id in removed[:SHOWN_IDS]:
            console.stdout.print(f"  {sequence_id}")
        if len(removed) > SHOWN_IDS:
            console.stdout.print(f"  and {len(removed) - SHOWN_IDS:,} more: --json names all")
        console.stdout.print(f"would remove {counted(len(removed), 'sequence')} from {path}")
        return
    manifest = read_manifest(path)
    if as_json:
        counts = {"sequences_in_store": manifest.num_sequences, "sequences_to_compact": manifest.num_removed}
        console.print_json({"store": str(path), "removed": removed, **counts})
        return
    console.stdout.print(
        f"removed {counted(len(removed), 'sequence')} from {path}, which holds {manifest.num_sequences:,}"
    )
    if manifest.num_removed:
        console.stdout.print(f"their frames leave the disk with 'motionkit compact --store {path}'")


def merge(
    out: Annotated[Path, typer.Argument(help="Store to make or to add to.", show_default=False)],
    sources: Annotated[list[Path], typer.Argument(help="Stores to copy from.", show_default=False)],
    where: console.Where = None,
    as_json: console.AsJson = False,
) -> None:
    """Copy stores into one, or a subset of a store into a new one, unchanged.

    Sequences that the target has from equal files are kept; nothing is written where one id stands for two files.

    Example: motionkit merge tests store --where "split = 'test'"
    """
    from motionkit.store.commit import read_manifest
    from motionkit.store.life import merge as merge_stores

    with console.progress() as show, task(show, "merge") as work:
        new, known = merge_stores(out, sources, where=where, on_start=work.set_total, on_sequence=work.advance)
    in_store = read_manifest(out).num_sequences
    if as_json:
        console.print_json({"store": str(out), "stored": new, "already_stored": known, "sequences_in_store": in_store})
        return
    console.stdout.print(f"stored {counted(new, 'sequence')} in {out}, which holds {in_store:,}")
    if known:
        console.stdout.print(f"already there: {known:,}")


def compact(store: ChangedStore = None, as_json: console.AsJson = False) -> None:
    """Rewrite a store's parts, full and without removed sequences; if interrupted, the store is unchanged.

    Sequences are renumbered from 0. Needs disk space for a second copy until it is done; programs that have the store
    open must reopen it. Removed sequences can then only be restored from their sources or a copy of the store. The
    store's fingerprint changes, so its training caches are rebuilt.

    Example: motionkit compact
    """
    from motionkit.store.commit import read_manifest
    from motionkit.store.life import compact as compact_store

    path = store or default_path("store")
    before = read_manifest(path)
    with console.progress() as show, task(show, "compact", before.num_sequences) as work:
        changed = compact_store(path, work.advance)
    after = read_manifest(path)
    if as_json:
        parts = {"parts_before": len(before.parts), "parts": len(after.parts)}
        sizes = {"bytes_before": before.num_bytes, "bytes": after.num_bytes}
        console.print_json({"store": str(path), **parts, **sizes})
        return
    if not changed:
        console.stdout.print(f"{path} is compact already")
        return
    console.stdout.print(
        f"{path}: {counted(len(before.parts), 'part')}, {before.num_bytes / MEGABYTE:,.1f} MB, became "
        f"{len(after.parts):,}, {after.num_bytes / MEGABYTE:,.1f} MB",
    )
