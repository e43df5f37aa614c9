"""`motionkit pull`: a store or a run from the Hugging Face Hub."""

from pathlib import Path
from typing import Annotated, Any

import typer

from motionkit.cli.console import print_json, progress, stdout
from motionkit.core.errors import UsageError
from motionkit.core.settings import default_path


def pull(
    address: Annotated[
        str,
        typer.Argument(
            help="hf://datasets/OWNER/NAME for a store, hf://OWNER/NAME for a run; or with @REVISION.",
            show_default=False,
        ),
    ],
    store: Annotated[Path | None, typer.Option(help="New folder for the store.", show_default="./store")] = None,
    run: Annotated[str | None, typer.Option(help="Name of the run here; the repository's by default.")] = None,
    runs: Annotated[Path | None, typer.Option(help="Folder of all runs.", show_default="./runs")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print what was pulled as JSON.")] = False,
) -> None:
    """Pull a store, or a run, from a repository of the Hugging Face Hub into a new folder.

    The folder appears once it is complete and its checksums match. An interrupted download continues when the command
    is repeated: files are kept in the Hub's cache ('hf cache' lists and frees it). Needs the extra 'hub'.

    Example: motionkit pull hf://datasets/me/walks --store walks
    """
    from motionkit.publish.downloads import pull_run, pull_store
    from motionkit.store.hub.repository import DATASET, parse_address

    repository = parse_address(address)
    found: dict[str, Any]
    with progress() as show:
        if repository.kind == DATASET:
            if run is not None:
                raise UsageError(f"{address} is a store: --run is for runs, hf://OWNER/NAME")
            folder = store or default_path("store")
            manifest = pull_store(repository, folder, show)
            found = {"sequences": manifest.num_sequences, "frames": manifest.num_frames}
            summary = f"{manifest.num_sequences:,} sequences, {manifest.num_frames:,} frames"
        else:
            if store is not None:
                raise UsageError(f"{address} is a run: --store is for stores, hf://datasets/OWNER/NAME")
            folder = (runs or default_path("runs")) / (run or repository.name.partition("/")[2])
            stages = pull_run(repository, folder, show)
            found, summary = {"stages": stages}, f"stages {', '.join(stages)}"
    if as_json:
        print_json({"repository": str(repository), "folder": str(folder), **found})
    else:
        stdout.print(f"pulled {repository} to {folder}: {summary}")
