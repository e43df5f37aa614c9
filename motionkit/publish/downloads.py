"""Pulls stores and runs from the Hub, verified and atomically."""

from pathlib import Path

from motionkit.core.errors import StoreError
from motionkit.core.files import require_empty, whole_folder
from motionkit.core.progress import OnProgress, ignore, task
from motionkit.publish.uploads import STAGE_FILE
from motionkit.store.fetched import fetch_store
from motionkit.store.hub.repository import HubError, Repository, copy_files, fetch, look_up
from motionkit.store.manifest import Manifest, read_manifest
from motionkit.store.schema import MANIFEST_FILE
from motionkit.store.validate import faults
from motionkit.training.run import RunFolder, weights_sha256

# Limit for files that are read into memory: a log of a million lines.
MOST_JSON_BYTES = 256 * 2**20


def pull_store(repository: Repository, folder: Path, on_progress: OnProgress = ignore) -> Manifest:
    """Copy a repository's store into a new or empty folder, after validating it.

    Raises `UsageError` for a folder that is not empty, `HubError`, and `StoreError` for a damaged store.
    """
    require_empty(folder)
    source = fetch_store(repository, on_progress)
    manifest = read_manifest(source)
    with whole_folder(folder.absolute()) as partial:
        require_empty(folder)
        copy_files(source, [MANIFEST_FILE, *manifest.files], partial)
        with task(on_progress, "check", len(manifest.files)) as work:
            fault = next(faults(partial, lambda _: work.advance()), None)
        if fault:
            raise StoreError(
                f"{repository} is damaged ({fault}): delete {source}, where it was fetched to, and pull again"
            )
    return manifest


def pull_run(repository: Repository, folder: Path, on_progress: OnProgress = ignore) -> list[str]:
    """Copy a repository's run into a new or empty folder, after verifying its checksums; returns its stages.

    Only settings, metrics and safetensors of complete stages are fetched. Raises `UsageError` for a folder that is not
    empty, `HubError`, and `DamagedFileError`.
    """
    require_empty(folder)
    snapshot = look_up(repository)
    named = [name for name in snapshot.sizes if STAGE_FILE.fullmatch(name)]
    stages = sorted(name.partition("/")[0] for name in named if name.endswith("/summary.json"))
    names = [name for name in named if name.partition("/")[0] in stages]
    if not names:
        raise HubError(f"{repository} holds no run (no STAGE/summary.json)")
    for name in names:
        if name.endswith((".json", ".jsonl")) and snapshot.sizes[name] > MOST_JSON_BYTES:
            raise HubError(f"{repository}: {name} has {snapshot.sizes[name]:,} bytes, too many")
    source = fetch(snapshot, names, on_progress)
    with whole_folder(folder.absolute()) as partial:
        require_empty(folder)
        copy_files(source, names, partial)
        weights_sha256(partial)
        for stage in stages:
            RunFolder(partial).stage(stage).check()
    return stages
