"""What every change of a store is made of: one lock, tables under pending names, the manifest's rename, tidying up."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from motionkit.checksums import sha256_of
from motionkit.errors import StoreError
from motionkit.interrupts import held_back
from motionkit.store import files
from motionkit.store.manifest import (
    PENDING_SUFFIX,
    FileEntry,
    Manifest,
    commit_manifest,
    describe_file,
    read_manifest,
)
from motionkit.store.schema import FORMAT_VERSION, MANIFEST_FILE, SEGMENTS_FOLDER, SEQUENCES_FILE, SKELETONS_FILE

TABLES = (SEQUENCES_FILE, SKELETONS_FILE)
EMPTY = Manifest(
    num_sequences=0, num_segments=0, num_frames=0, num_skeletons=0, next_sequence_index=0, next_part=0, files={}
)


@contextmanager
def changing(store: Path, *, must_exist: bool = False, must_not_exist: bool = False) -> Iterator[Manifest]:
    """Hold the writer's lock on a store, or on a folder that becomes one; yields its state, `EMPTY` for a new one.

    What a killed writer left is finished or removed first; what this one has written is removed where the block raises
    before its commit, and kept after it. Raises `StoreError` for a store that is busy, missing,
    present or not a store.
    """
    _check_target(store, must_exist=must_exist, must_not_exist=must_not_exist)
    (store / SEGMENTS_FOLDER).mkdir(parents=True, exist_ok=True)
    busy = f"another process is writing to the store {store}: wait until it has ended"
    with files.exclusive_lock(store / files.LOCK_FILE, busy=busy):
        _check_target(store, must_exist=must_exist, must_not_exist=must_not_exist)
        manifest = committed(store)
        _tidy(store, manifest)
        try:
            yield manifest
        except BaseException:
            with held_back():
                if committed(store) == manifest:
                    _tidy(store, manifest)
            raise


def committed(store: Path) -> Manifest:
    """The state that a reader would see now; `EMPTY` where there is no store yet."""
    return read_manifest(store) if (store / MANIFEST_FILE).exists() else EMPTY


def require_present_version(store: Path, manifest: Manifest) -> None:
    """Raise `StoreError`, naming the command, for a store of an earlier format version: it is read, not changed."""
    if manifest.format_version != FORMAT_VERSION:
        raise StoreError(
            f"the store {store} has format version {manifest.format_version}, which can be read but not changed: "
            f"bring it to version {FORMAT_VERSION} with 'motionkit migrate --store {store}'"
        )


def pending(store: Path, name: str) -> Path:
    """Where a table is written before it is committed."""
    return store / (name + PENDING_SUFFIX)


def describe_pending(store: Path, num_rows: Mapping[str, int]) -> dict[str, FileEntry]:
    """The manifest's entries for finished pending tables, by their names and numbers of rows."""
    entries = {}
    for name, rows in num_rows.items():
        files.sync_file(pending(store, name))
        entries[name] = describe_file(pending(store, name), rows)
    return entries


def publish(store: Path, manifest: Manifest) -> None:
    """The commit: from the rename of the manifest on, the store is what it says; then the tables get their names."""
    with held_back():
        commit_manifest(store, manifest)
        _tidy(store, manifest)


def _tidy(store: Path, manifest: Manifest) -> None:
    for name in TABLES:
        path = pending(store, name)
        if name in manifest.files and path.exists() and sha256_of(path) == manifest.files[name].sha256:
            files.replace(path, store / name)
    for name in (*TABLES, MANIFEST_FILE):
        pending(store, name).unlink(missing_ok=True)
    for path in (store / SEGMENTS_FOLDER).glob("part-*.parquet*"):
        if f"{SEGMENTS_FOLDER}/{path.name}" not in manifest.files:
            path.unlink(missing_ok=True)


def _check_target(path: Path, *, must_exist: bool, must_not_exist: bool) -> None:
    if path.exists() and not path.is_dir():
        raise StoreError(f"{path} is a file; a store is a folder")
    is_store = (path / MANIFEST_FILE).exists()
    if must_exist and not is_store:
        read_manifest(path)
    if must_not_exist and is_store:
        raise StoreError(f"there already is a store at {path}: append to it, or overwrite it on purpose")
    if not is_store and path.exists():
        ours = {SEGMENTS_FOLDER, files.LOCK_FILE, *(name + PENDING_SUFFIX for name in (*TABLES, MANIFEST_FILE))}
        foreign = sorted(entry.name for entry in path.iterdir() if entry.name not in ours)
        if foreign:
            raise StoreError(f"{path} is not a store and not empty (it holds {foreign[0]}): name an empty folder")
