"""Stores on the Hub: downloads a store to the Hub's cache, and checks names and sizes against its manifest."""

from pathlib import Path

from motionkit.core.errors import StoreError
from motionkit.core.progress import OnProgress, ignore
from motionkit.store.hub.repository import HubError, Repository, fetch, look_up
from motionkit.store.manifest import read_manifest
from motionkit.store.schema import MANIFEST_FILE

# 300 bytes per part: half a million parts.
MOST_MANIFEST_BYTES = 150 * 2**20


def fetch_store(repository: Repository, on_progress: OnProgress = ignore) -> Path:
    """Downloads the files that a repository's manifest names; returns their folder in the cache.

    Sizes are compared before anything is downloaded; checksums when a file is read, as for any store. Raises
    `HubError`, and `StoreError` for a repository without a store, or with an incomplete one.
    """
    snapshot = look_up(repository)
    if MANIFEST_FILE not in snapshot.sizes:
        raise HubError(
            f"{repository} holds no store (no {MANIFEST_FILE}); captures and exported Parquet come in with "
            f"'motionkit ingest {repository}'"
        )
    if snapshot.sizes[MANIFEST_FILE] > MOST_MANIFEST_BYTES:
        raise StoreError(f"{repository}: {MANIFEST_FILE} has {snapshot.sizes[MANIFEST_FILE]:,} bytes, too many")
    manifest = read_manifest(fetch(snapshot, [MANIFEST_FILE]))
    for name, entry in manifest.files.items():
        found = snapshot.sizes.get(name)
        if found != entry.num_bytes:
            has = "is missing" if found is None else f"has {found:,} bytes instead of {entry.num_bytes:,}"
            raise StoreError(f"{repository} holds no whole store: {name} {has}; who pushed it pushes it again")
    return fetch(snapshot, [MANIFEST_FILE, *manifest.files], on_progress)
