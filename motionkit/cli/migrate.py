"""`motionkit migrate`: upgrade a store to the current format version."""

from pathlib import Path
from typing import Annotated

import typer

from motionkit.cli.console import print_json, progress, stdout
from motionkit.core.progress import task
from motionkit.core.settings import default_path


def migrate(
    store: Annotated[Path | None, typer.Option(help="Store to migrate.", show_default="./store")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print what was done as JSON.")] = False,
) -> None:
    """Upgrade a store to the current format version, in place; if interrupted, it is unchanged.

    Needs disk space for a second copy until it is done.

    Example: motionkit migrate --store store
    """
    from motionkit.store.life.rewrite import migrate as migrate_store
    from motionkit.store.manifest import read_manifest

    path = store or default_path("store")
    before = read_manifest(path)
    with progress() as show, task(show, "migrate", before.num_sequences) as work:
        migrated = migrate_store(path, work.advance)
    after = read_manifest(path)
    if as_json:
        print_json({"store": str(path), "from_version": before.format_version, "to_version": after.format_version})
    elif migrated:
        stdout.print(
            f"{path}: {after.num_sequences:,} sequences from format version {before.format_version} to "
            f"{after.format_version}",
        )
    else:
        stdout.print(f"{path} has format version {after.format_version} already")
