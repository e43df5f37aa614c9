"""`motionkit validate`: check a store's integrity."""

from pathlib import Path
from typing import Annotated

import typer

from motionkit.cli.console import print_json, progress, stdout
from motionkit.cli.options import StoreArgument, named_store
from motionkit.core.files import default_path
from motionkit.core.progress import task


def validate(
    path: StoreArgument = None,
    store: Annotated[Path | None, typer.Option(help="Store to check.", show_default="./store")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the faults as JSON.")] = False,
) -> None:
    """Check every file of a store: checksums, tables, finite frames.

    Prints a line for each fault. Exit code 1 if there is any, else 0.

    Example: motionkit validate
    """
    from motionkit.store.commit import read_manifest
    from motionkit.store.validate import faults

    path = named_store(path, store) or default_path("store")
    manifest = read_manifest(path)
    with progress() as show, task(show, "validate", len(manifest.files)) as work:

        def on_file(name: str) -> None:
            work.note(name)
            work.advance()

        found = list(faults(path, on_file))
    if as_json:
        print_json({"store": str(path), "fingerprint": manifest.fingerprint, "faults": found})
    else:
        for fault in found:
            stdout.print(fault)
        if not found:
            stdout.print(
                f"{path} is intact: {manifest.num_sequences:,} sequences, {len(manifest.files)} files",
            )
    if found:
        raise typer.Exit(1)
