"""`motionkit push`: a store or a run onto the Hugging Face Hub."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from motionkit.cli.console import print_json, progress, stdout
from motionkit.core.errors import UsageError
from motionkit.core.settings import default_path

if TYPE_CHECKING:
    from motionkit.core.progress import OnProgress
    from motionkit.publish.uploads import Upload
    from motionkit.store.hub.repository import Repository

MEGABYTE = 1e6


def push(
    address: Annotated[
        str,
        typer.Argument(help="hf://datasets/OWNER/NAME for a store, hf://OWNER/NAME for a run.", show_default=False),
    ],
    store: Annotated[Path | None, typer.Option(help="Store to push.", show_default="./store")] = None,
    run: Annotated[str | None, typer.Option(help="Run to push: its complete stages, without checkpoints.")] = None,
    runs: Annotated[Path | None, typer.Option(help="Folder of all runs.", show_default="./runs")] = None,
    public: Annotated[bool, typer.Option("--public", help="Let everybody have it; else it is private.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be pushed; the Hub is not asked.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print what was pushed as JSON.")] = False,
) -> None:
    """Validate a store, or a run, and push it with a card to a repository of the Hugging Face Hub.

    The push is a single commit; the repository is created if needed. Log in first ('hf auth login'). A run's
    config.json contains its store's path, and the platform it was trained on. Needs the extra 'hub'.

    Example: motionkit push hf://datasets/me/walks --dry-run
    """
    from motionkit.store.hub.repository import parse_address
    from motionkit.store.hub.repository import push as push_files

    repository = parse_address(address)
    if repository.folder:
        raise UsageError(f"{address}: push to a whole repository, without /{repository.folder}")
    with progress() as show:
        upload = _upload(repository, store, runs, run, show)
        url = "" if dry_run else push_files(repository, upload.files, upload.replaces, public, show)
    if as_json:
        files = {"files": sorted(upload.files), "bytes": upload.num_bytes, "licences": upload.licences}
        print_json({"repository": str(repository), "dry_run": dry_run, "commit": url, **files})
        return
    for name in upload.licences:
        stdout.print(f"  licence: {name or 'not stated'}")
    done = "would push" if dry_run else "pushed"
    stdout.print(
        f"{done} {len(upload.files):,} files, {upload.num_bytes / MEGABYTE:,.1f} MB, to {repository}"
        f"{f' ({url})' if url else ''}"
    )


def _upload(
    repository: "Repository", store: Path | None, runs: Path | None, run: str | None, show: "OnProgress"
) -> "Upload":
    from motionkit.publish.uploads import run_upload, store_upload
    from motionkit.store.hub.repository import DATASET
    from motionkit.training.run import RunFolder

    if repository.kind == DATASET:
        if run is not None:
            raise UsageError(f"a run goes to hf://{repository.name}: hf://datasets/ is for stores")
        return store_upload(store or default_path("store"), repository, show)
    if store is not None or run is None:
        raise UsageError(f"{repository} is for a run: name one with --run; a store goes to hf://datasets/OWNER/NAME")
    return run_upload(RunFolder((runs or default_path("runs")) / run), repository)
