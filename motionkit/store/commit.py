"""Atomic changes of a store: a lock, tables under pending names, the manifest's rename as commit, and cleanup."""

import os
import re
import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from motionkit.core import files
from motionkit.core.errors import StoreError, describe
from motionkit.core.files import defer_signals, exclusive_lock
from motionkit.store.manifest import (
    PENDING_SUFFIX,
    TABLES,
    FileEntry,
    Manifest,
    commit_manifest,
    describe_file,
    read_manifest,
)
from motionkit.store.schema import (
    MANIFEST_FILE,
    SEGMENTS_FOLDER,
    SEQUENCES_PER_ROW_GROUP,
    table_writer_options,
)

_PART = re.compile(
    rf"part-[0-9]{{5,10}}(\.parquet|\.parquet{re.escape(PENDING_SUFFIX)}|-[0-9a-f]{{8}}\.parquet{re.escape(PENDING_SUFFIX)})"
)
LOCK_FILE = ".writer.lock"
EMPTY = Manifest(
    num_sequences=0, num_segments=0, num_frames=0, num_skeletons=0, next_sequence_index=0, next_part=0, files={}
)


@contextmanager
def changing(store: Path, *, must_exist: bool = False, must_not_exist: bool = False) -> Iterator[Manifest]:
    """Hold the writer's lock on a store, or on a folder that becomes one; yields its state, `EMPTY` for a new one.

    What a killed writer left is finished or removed first; what this one has written is removed where the block raises
    before its commit, and kept after it. Raises `BusyError` while another process writes; `StoreError` for a store that
    is missing, present or not a store, and where the disk fails after the commit; `OSError`
    where it fails before the commit.
    """
    _check_target(store, must_exist=must_exist, must_not_exist=must_not_exist)
    (store / SEGMENTS_FOLDER).mkdir(parents=True, exist_ok=True)
    busy = f"another process is writing to the store {store}: wait until it has ended"
    with exclusive_lock(store / LOCK_FILE, busy=busy):
        _check_target(store, must_exist=must_exist, must_not_exist=must_not_exist)
        manifest = committed(store)
        _tidy(store, manifest)
        try:
            yield manifest
        except BaseException as error:
            with defer_signals():
                unchanged = committed(store) == manifest
                if unchanged:
                    _tidy(store, manifest)
            if isinstance(error, OSError) and not unchanged:
                raise StoreError(
                    f"the change of the store {store} is committed, but its disk failed after that "
                    f"({describe(error)}): check the disk, then run 'motionkit validate --store {store}'"
                ) from error
            raise


def committed(store: Path) -> Manifest:
    """The state that a reader would see now; `EMPTY` if there is no store yet."""
    return read_manifest(store) if files.is_store(store) else EMPTY


def pending(store: Path, name: str) -> Path:
    """Path of a table before it is committed."""
    return store / (name + PENDING_SUFFIX)


def unique_pending_part(store: Path, number: int) -> Path:
    """Path of a part before it is adopted: several processes may be writing the same one."""
    return store / SEGMENTS_FOLDER / f"part-{number:05d}-{secrets.token_hex(4)}.parquet{PENDING_SUFFIX}"


def write_pending(store: Path, name: str, table: pa.Table) -> None:
    """Writes a table to its pending path; raises `OSError` that names the file."""
    path = pending(store, name)
    with files.naming(path):
        files.create(path)
        pq.write_table(table, path, row_group_size=SEQUENCES_PER_ROW_GROUP, **table_writer_options())


def describe_pending(store: Path, num_rows: Mapping[str, int]) -> dict[str, FileEntry]:
    """The manifest's entries for finished pending tables, by their names and numbers of rows."""
    entries = {}
    for name, rows in num_rows.items():
        files.sync(pending(store, name))
        entries[name] = describe_file(pending(store, name), rows)
    return entries


def publish(store: Path, manifest: Manifest) -> None:
    """Commits: the rename of the manifest changes the store's state; then the tables get their final names."""
    with defer_signals():
        commit_manifest(store, manifest)
        _tidy(store, manifest)


def leftovers(store: Path, manifest: Manifest) -> list[Path]:
    """Files left by a stopped command: parts that the manifest does not name, and pending files.

    While a part that it names is missing, no parts are included: one may be that part under a wrong name.
    """
    folder = store / SEGMENTS_FOLDER
    found = sorted(path for path in folder.iterdir() if _PART.fullmatch(path.name)) if folder.is_dir() else []
    complete = all((store / name).exists() for name in manifest.parts)
    unnamed = [path for path in found if f"{SEGMENTS_FOLDER}/{path.name}" not in manifest.files]
    parts = [path for path in unnamed if complete or path.name.endswith(PENDING_SUFFIX)]
    return parts + [path for name in (*TABLES, MANIFEST_FILE) if os.path.lexists(path := pending(store, name))]


def _tidy(store: Path, manifest: Manifest) -> None:
    for name in TABLES:
        path = pending(store, name)
        if name in manifest.files and _is_committed(path, manifest.files[name]):
            files.replace(path, store / name)
    for path in leftovers(store, manifest):
        path.unlink(missing_ok=True)


def _is_committed(path: Path, entry: FileEntry) -> bool:
    """Whether a pending table is the one that the manifest names: its writer was stopped after the commit."""
    return path.is_file() and not path.is_symlink() and describe_file(path, entry.num_rows) == entry


def _check_target(path: Path, *, must_exist: bool, must_not_exist: bool) -> None:
    if path.exists() and not path.is_dir():
        raise StoreError(f"{path} is a file; a store is a folder")
    is_store = files.is_store(path)
    if must_exist and not is_store:
        read_manifest(path)
    if must_not_exist and is_store:
        raise StoreError(f"there already is a store at {path}: append to it, or overwrite it on purpose")
    if not is_store and path.exists():
        ours = {SEGMENTS_FOLDER, LOCK_FILE, *(name + PENDING_SUFFIX for name in (*TABLES, MANIFEST_FILE))}
        foreign = sorted(entry.name for entry in path.iterdir() if entry.name not in ours)
        if foreign:
            raise StoreError(f"{path} is not a store and not empty (it holds {foreign[0]}): name an empty folder")
