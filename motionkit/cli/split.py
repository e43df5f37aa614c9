"""`motionkit split`: divide a store's sequences into training and held-out splits."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from motionkit.cli.console import print_json, say_next, stdout
from motionkit.cli.options import StoreArgument, named_store, of_default
from motionkit.core.errors import UsageError
from motionkit.core.files import default_path

if TYPE_CHECKING:
    from motionkit.store.life.splits import SplitReport


def split(
    path: StoreArgument = None,
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
    store: Annotated[Path | None, typer.Option(help="Store to change.", show_default="./store")] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be done, and leave the store.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON.")] = False,
) -> None:
    """Split a store into train, val and test so that held-out performers are not in training.

    The sources' own splits are replaced. The store's fingerprint changes, and runs trained on it no longer match:
    split before training, or split a copy ('motionkit merge').

    Example: motionkit split --by sequence_id --shares train=0.6,test=0.4
    """
    from motionkit.store.life.splits import PERFORMER
    from motionkit.store.life.splits import split as split_store

    wanted, store = parse_shares(shares), named_store(path, store)
    together = by or [PERFORMER]
    report = split_store(store or default_path("store"), wanted, by=together, where=where, seed=seed, dry_run=dry_run)
    if as_json:
        print_json({**asdict(report), "store": str(report.store), "seed": seed, "dry_run": dry_run})
    else:
        _print(report, dry_run)
        if not dry_run:
            say_next(f"motionkit train{of_default('--store', store)}")


def parse_shares(text: str) -> dict[str, float]:
    """Parse `train=0.8,test=0.2`; raises `UsageError` for anything else."""
    found: dict[str, float] = {}
    for part in text.split(","):
        name, equals, number = (piece.strip() for piece in part.partition("="))
        try:
            share = float(number)
        except ValueError:
            share = float("nan")
        if not equals or share != share:
            raise UsageError(f"--shares takes SPLIT=NUMBER,… (train=0.8,val=0.05,test=0.15), not {text!r}")
        if name in found:
            raise UsageError(f"--shares names {name!r} twice: {text!r}")
        found[name] = share
    return found


def _print(report: "SplitReport", dry_run: bool) -> None:
    stdout.print(
        f"{'split':8}{'share':>8}{'asked':>8}{'hours':>10}{'groups':>10}{'sequences':>12}{'wordings seen':>16}"
    )
    for each in report.splits:
        hours = each.duration_seconds / 3600
        stdout.print(
            f"{each.split:8}{each.share:8.3f}{each.asked_share:8.3f}{hours:10.2f}{each.num_groups:10,}"
            f"{each.num_sequences:12,}{f'{each.num_seen:,} of {each.num_captioned:,}':>16}",
        )
    doing = "would change" if dry_run else "changed"
    stdout.print(f"{doing} the split of {report.num_changed:,} sequences of {report.store}, by {report.by}")
