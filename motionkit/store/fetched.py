"""A store that lies on the Hub: its files in the Hub's cache, named and sized as its manifest says."""

from pathlib import Path

from motionkit.core.errors import StoreError
from motionkit.core.progress import OnProgress, ignore
from motionkit.hub.repository import HubError, Repository, fetch, look_up
from motionkit.store.manifest import read_manifest
from motionkit.store.schema import MANIFEST_FILE

# 300 bytes for each part: half a million of them.
MOST_MANIFEST_BYTES = 150 * 2**20


def fetch_store(repository: Repository, on_progress: OnProgress = ignore) -> Path:
    """The folder of the cache that holds a repository's store, nothing fetched but what its manifest names.

    Sizes are compared before anything is fetched; checksums are compared as of any store, when a file is read. Raises
    `HubError`, and `StoreError` for a repository without a store, or with a part of one.
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
