"""`motionkit remove`: sequences leave a store."""

from pathlib import Path
from typing import Annotated

import typer

from motionkit.cli.console import print_json, stdout
from motionkit.core.errors import UsageError
from motionkit.core.settings import default_path


def remove(
    ids: Annotated[list[str] | None, typer.Argument(help="Ids of sequences.", show_default=False)] = None,
    where: Annotated[
        str | None, typer.Option(metavar="SQL", help="Condition over the table of sequences: \"source = 'CMU'\".")
    ] = None,
    store: Annotated[Path | None, typer.Option(help="Store to remove from.", show_default="./store")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the removed ids as JSON.")] = False,
) -> None:
    """Remove sequences from a store, by id or by a condition.

    They are gone from its tables at once; their frames leave the disk with 'motionkit compact'.
    """
    from motionkit.store.life.rewrite import remove as remove_sequences
    from motionkit.store.manifest import read_manifest

    if not ids and where is None:
        raise UsageError("name the sequences to remove, by their ids or with --where")
    path = store or default_path("store")
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
                "segments_to_compact": manifest.num_removed_segments,
            }
        )
        return
    stdout.print(
        f"removed {len(removed):,} sequences from {path}, which holds {manifest.num_sequences:,}", markup=False
    )
    if manifest.num_removed_segments:
        stdout.print(f"their frames leave the disk with 'motionkit compact --store {path}'")
