"""The state of a store: the manifest, which lists its files with their checksums, its tables, and the commit.

A writer holds the lock, writes parts and tables under pending names (`.new`), and renames the manifest, which commits
them. A reader sees the manifest before or after that rename, and the files that it names.
"""

import hashlib
import json
import math
import re
import secrets
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from motionkit.core import __version__, files
from motionkit.core.errors import MotionkitError, StoreError, describe
from motionkit.core.files import MANIFEST_FILE, MOTIONS_FOLDER, SEQUENCES_FILE, defer_signals, exclusive_lock, sha256_of
from motionkit.core.skeleton import Skeleton
from motionkit.core.skeletons.mapping import parse_layout_map
from motionkit.store.schema import (
    SEQUENCES,
    SEQUENCES_PER_ROW_GROUP,
    SKELETONS,
    SKELETONS_FILE,
    TABLE_OPTIONS,
    part_name,
    part_number,
    skeleton_from_row,
)

FORMAT = "motionkit-store"
VERSION = 3
TABLES = (SEQUENCES_FILE, SKELETONS_FILE)
PENDING = ".new"
LOCK_FILE = ".writer.lock"
# Numbers of sequences and of parts are int32 in the tables.
MAX_NUMBER = 2**31
_PART = re.compile(rf"{MOTIONS_FOLDER}/part-[0-9]{{5,10}}\.parquet")
_WRITTEN_PART = re.compile(r"part-[0-9]{5,10}(-[0-9a-f]{8})?\.parquet(\.new)?")
_SHA256 = re.compile("[0-9a-f]{64}")
_HINT = "restore it from a copy, or ingest the sources into a new store"


@dataclass(frozen=True)
class FileEntry:
    """One file of a store: its sha256, size in bytes and number of rows."""

    sha256: str
    num_bytes: int
    num_rows: int


@dataclass(frozen=True)
class Manifest:
    """A committed state of a store; `files` maps paths inside the store to their entries.

    It holds no date and no machine name, so equal content gives an equal fingerprint. `next_sequence_index` and
    `next_part` are above all numbers that were assigned, so that none is assigned again.
    """

    files: Mapping[str, FileEntry] = field(default_factory=dict)
    next_sequence_index: int = 0
    next_part: int = 0
    tool: str = f"motionkit {__version__}"

    @property
    def num_sequences(self) -> int:
        """Number of sequences."""
        return self.files[SEQUENCES_FILE].num_rows if SEQUENCES_FILE in self.files else 0

    @property
    def num_removed(self) -> int:
        """Number of removed sequences whose frames are still in the parts: `motionkit compact` drops them."""
        return sum(self.files[name].num_rows for name in self.parts) - self.num_sequences

    @property
    def num_bytes(self) -> int:
        """Total bytes of its files."""
        return sum(entry.num_bytes for entry in self.files.values())

    @property
    def parts(self) -> tuple[str, ...]:
        """Paths of the parts inside the store, in order."""
        return tuple(sorted(self.files.keys() - TABLES, key=part_number))

    @property
    def text(self) -> str:
        """The manifest as JSON."""
        document = {
            "format": FORMAT,
            "format_version": VERSION,
            "tool": self.tool,
            "next": {"sequence_index": self.next_sequence_index, "part": self.next_part},
            "files": {name: asdict(entry) for name, entry in sorted(self.files.items())},
        }
        return json.dumps(document, indent=2) + "\n"

    @property
    def fingerprint(self) -> str:
        """Hex sha256 of the manifest, which holds those of all files: equal for equal stores."""
        return hashlib.sha256(self.text.encode()).hexdigest()


def read_manifest(store: Path) -> Manifest:
    """Read a store's manifest; raises `StoreError` where there is none, or it is damaged or of another version."""
    path = store / MANIFEST_FILE
    try:
        files.require_regular(path)
        document = json.loads(path.read_bytes())
        if not isinstance(document, dict) or document.get("format") != FORMAT:
            raise ValueError(f"it is not the manifest of a store: its 'format' is not {FORMAT!r}")
        version = document.get("format_version")
        if version != VERSION:
            raise StoreError(
                f"the store {store} has format version {version!r} and was written by {document.get('tool')!r}, "
                f"but motionkit {__version__} reads version {VERSION}: ingest the sources again"
            )
        manifest = Manifest(
            files={name: _entry(name, entry) for name, entry in document["files"].items()},
            next_sequence_index=_count(document["next"], "sequence_index"),
            next_part=_count(document["next"], "part"),
            tool=document["tool"],
        )
        if not (isinstance(manifest.tool, str) and manifest.tool.isprintable()):
            raise ValueError(f"its tool is {manifest.tool!r}")
        if not manifest.num_sequences <= manifest.next_sequence_index <= MAX_NUMBER:
            raise ValueError(f"next.sequence_index is below its {manifest.num_sequences} sequences")
        if not max(map(part_number, manifest.parts), default=-1) < manifest.next_part <= MAX_NUMBER:
            raise ValueError(f"next.part is not above {manifest.parts[-1] if manifest.parts else 'MAX_NUMBER'}")
        return manifest
    except FileNotFoundError:
        raise StoreError(
            f"there is no store at {store}: make one with 'motionkit ingest SOURCE --store {store}'"
        ) from None
    except NotADirectoryError:
        raise StoreError(
            f"{store} is a file, and a store is a folder: 'motionkit ingest {store}' puts a motion into one, "
            f"'motionkit view {store}' shows it"
        ) from None
    except OSError as error:
        raise StoreError(describe(error)) from None
    except (KeyError, ValueError, TypeError, AttributeError, RecursionError) as error:
        fault = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise StoreError(f"{path} is damaged ({fault}): {_HINT}") from None


def _entry(name: str, entry: Any) -> FileEntry:
    if name not in TABLES and not (_PART.fullmatch(name) and name == part_name(part_number(name))):
        raise ValueError(f"it names {name!r}, which is no file of a store")
    if not isinstance(entry, dict):
        raise ValueError(f"{name} is {str(entry)[:40]!r}")
    if not (isinstance(entry["sha256"], str) and _SHA256.fullmatch(entry["sha256"])):
        raise ValueError(f"the sha256 of {name} is {entry['sha256']!r}")
    return FileEntry(entry["sha256"], _count(entry, "num_bytes"), _count(entry, "num_rows"))


def _count(values: Any, name: str) -> int:
    value = values[name]
    if type(value) is not int or not 0 <= value < 2**63:
        raise ValueError(f"{name} is {value!r}")
    return value


def committed(store: Path) -> Manifest:
    """The state that a reader would see now; an empty manifest if there is no store yet."""
    return read_manifest(store) if files.is_store(store) else Manifest()


def read_table(store: Path, manifest: Manifest, name: str, columns: Sequence[str] | None = None) -> pa.Table:
    """A table, or some of its columns, as the manifest names it.

    A writer that is killed between the rename of the manifest and those of its tables leaves a committed table under
    its pending name until the next writer renames it. The checksum says which file it is, also while a writer works.
    Raises `FileNotFoundError` where no file is that one, as after a commit that came in between; `ValueError` for a
    table with other columns or another number of rows, and for what is no Parquet.
    """
    entry = manifest.files.get(name)
    if entry is None:
        raise ValueError(f"{name}: the manifest does not name it")
    content = b""
    # The first path again, for a writer may rename a table between the two.
    for path in (store / name, pending(store, name), store / name):
        with suppress(FileNotFoundError):
            if path.stat().st_size == entry.num_bytes:
                content = path.read_bytes()
                if hashlib.sha256(content).hexdigest() == entry.sha256:
                    break
    else:
        is_there = (store / name).exists()
        raise FileNotFoundError(f"{name}: " + ("its sha256 is not the manifest's" if is_there else "it is missing"))
    try:
        # One thread: Arrow's own would keep the content for some milliseconds after the call, and where one of them
        # frees a Python object while the interpreter ends, the process aborts (apache/arrow issues 36389 and 49942).
        file = pq.ParquetFile(pa.BufferReader(content))
        table = file.read(columns, use_threads=False)
        table.validate(full=True)  # texts that are no UTF-8, lists that leave their values
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{name}: it cannot be read as Parquet ({' '.join(str(error).split())})") from None
    if not file.schema_arrow.equals({SEQUENCES_FILE: SEQUENCES, SKELETONS_FILE: SKELETONS}[name]):
        raise ValueError(f"{name}: its columns are not those of this format version")
    if table.num_rows != entry.num_rows:
        raise ValueError(f"{name}: it has {table.num_rows} rows, the manifest says {entry.num_rows}")
    return table.combine_chunks()


def read_skeletons(table: pa.Table) -> dict[str, Skeleton]:
    """The skeletons of a table by fingerprint; raises `ValueError` for a row that is none."""
    skeletons = {}
    for row in table.to_pylist():
        try:
            skeleton = skeleton_from_row(row)
            if skeleton.layout_map:
                parse_layout_map(skeleton.layout_map)
            if skeleton.fingerprint != row["skeleton"]:
                raise ValueError(f"its joints are those of {skeleton.fingerprint!r}")
        except (ValueError, MotionkitError) as error:
            raise ValueError(f"{SKELETONS_FILE}: skeleton {row['skeleton']!r}: {error}") from None
        skeletons[row["skeleton"]] = skeleton
    return skeletons


def check_sequences(sequences: pa.Table, manifest: Manifest, skeletons: Mapping[str, Skeleton]) -> None:
    """Raise `ValueError` for rows that no writer writes, in a store of somebody else's making.

    Indices ascend below the manifest's next one, ids are unique, framerates positive, and every row has frames, a part
    that the manifest names, and one of the skeletons.
    """
    # Not by numpy: what Arrow converts to arrays or from numbers imports pandas, which takes longer than all of this.
    index = sequences["sequence_index"].to_pylist()
    if any(after <= before for before, after in pairwise([-1, *index, manifest.next_sequence_index])):
        raise ValueError(
            f"{SEQUENCES_FILE}: sequence_index does not ascend from 0 to below {manifest.next_sequence_index}"
        )
    ids = sequences["sequence_id"]
    if pc.count_distinct(ids).as_py() != len(ids):
        counts = pc.value_counts(ids)
        repeated = counts.filter(pc.greater(counts.field("counts"), 1))[0]["values"]
        raise ValueError(f"{SEQUENCES_FILE}: the id {repeated.as_py()!r} occurs more than once")
    parts = set(map(part_number, manifest.parts))
    rules: dict[str, tuple[Callable[[Any], bool], str]] = {
        "fps_numerator": (lambda number: number > 0, "its framerate is not positive"),
        "fps_denominator": (lambda number: number > 0, "its framerate is not positive"),
        "num_frames": (lambda number: number > 0, "it has no frames"),
        "start_seconds": (math.isfinite, "its start_seconds are not finite"),
        "part": (parts.__contains__, "the manifest does not name its part"),
        "skeleton": (skeletons.__contains__, f"its skeleton is not in {SKELETONS_FILE}"),
    }
    for column, (is_valid, fault) in rules.items():
        if not all(map(is_valid, pc.unique(sequences[column]).to_pylist())):
            row = next(row for row, value in enumerate(sequences[column].to_pylist()) if not is_valid(value))
            raise ValueError(f"{SEQUENCES_FILE}: sequence {ids[row].as_py()!r}: {fault}")
    bodies = zip(sequences["skeleton"].to_pylist(), sequences["num_joints"].to_pylist(), strict=True)
    for row, (skeleton, num_joints) in enumerate(bodies):
        if num_joints != skeletons[skeleton].num_joints:
            raise ValueError(f"{SEQUENCES_FILE}: sequence {ids[row].as_py()!r}: num_joints is not its skeleton's")


def damaged(store: Path, fault: Exception | str) -> StoreError:
    """The error where a file is missing or damaged: the fault, and what to do."""
    return StoreError(
        f"the store {store} is damaged: {fault}: 'motionkit validate --store {store}' says all that is wrong; {_HINT}"
    )


@contextmanager
def changing(store: Path, *, must_exist: bool = False, must_not_exist: bool = False) -> Iterator[Manifest]:
    """Hold the writer's lock on a store, or on a folder that becomes one; yields its state, an empty one if it is new.

    What a killed writer left is finished or removed first; what this one has written is removed where the block raises
    before its commit, and kept after it. Raises `BusyError` while another process writes; `StoreError` for a store that
    is missing, present or not a store, and where the disk fails after the commit; `OSError` where it fails before it.
    """
    _check_target(store, must_exist=must_exist, must_not_exist=must_not_exist)
    (store / MOTIONS_FOLDER).mkdir(parents=True, exist_ok=True)
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


def _check_target(path: Path, *, must_exist: bool, must_not_exist: bool) -> None:
    if path.exists() and not path.is_dir():
        raise StoreError(f"{path} is a file; a store is a folder")
    is_store = files.is_store(path)
    if must_exist and not is_store:
        read_manifest(path)
    if must_not_exist and is_store:
        raise StoreError(f"{path} is a store already: StoreWriter.append adds to it, overwrite=True replaces it")
    if not is_store and path.exists():
        ours = {MOTIONS_FOLDER, LOCK_FILE, *(name + PENDING for name in (*TABLES, MANIFEST_FILE))}
        foreign = sorted(entry.name for entry in path.iterdir() if entry.name not in ours)
        if foreign:
            raise StoreError(f"{path} is not a store and not empty (it holds {foreign[0]}): name an empty folder")


def pending(store: Path, name: str) -> Path:
    """Path of a file before it is committed."""
    return store / (name + PENDING)


def pending_part(store: Path, number: int) -> Path:
    """Path of a part before it is added: several processes may be writing one of this number."""
    return store / MOTIONS_FOLDER / f"part-{number:05d}-{secrets.token_hex(4)}.parquet{PENDING}"


def write_pending(store: Path, name: str, table: pa.Table) -> FileEntry:
    """Write a table to its pending path; returns its entry. Raises `OSError` that names the file."""
    path = pending(store, name)
    with files.naming(path):
        files.create(path)
        pq.write_table(table, path, row_group_size=SEQUENCES_PER_ROW_GROUP, **TABLE_OPTIONS)
    return finished_entry(path, table.num_rows)


def finished_entry(path: Path, num_rows: int) -> FileEntry:
    """Flush a finished file to the disk; returns its entry for the manifest."""
    files.sync(path)
    return FileEntry(sha256_of(path), path.stat().st_size, num_rows)


def publish(store: Path, manifest: Manifest) -> None:
    """Commit: the rename of the manifest changes the store's state; then the tables get their final names."""
    with defer_signals():
        path = pending(store, MANIFEST_FILE)
        with files.naming(path):
            files.create(path)
            path.write_text(manifest.text, encoding="utf-8")
        files.replace(path, store / MANIFEST_FILE)
        _tidy(store, manifest)


def _tidy(store: Path, manifest: Manifest) -> None:
    """Give committed tables their final names, and delete what a stopped command left: pending files, unnamed parts."""
    for name in TABLES:
        path = pending(store, name)
        # A pending table is the one that the manifest names where its writer was stopped after the commit.
        is_file = path.is_file() and not path.is_symlink()
        if is_file and name in manifest.files and sha256_of(path) == manifest.files[name].sha256:
            files.replace(path, store / name)
    folder = store / MOTIONS_FOLDER
    # Nothing is deleted behind a link.
    for path in list(folder.iterdir()) if folder.is_dir() and not folder.is_symlink() else ():
        is_named = f"{MOTIONS_FOLDER}/{path.name}" in manifest.files
        if _WRITTEN_PART.fullmatch(path.name) and not is_named:
            path.unlink(missing_ok=True)
    for name in (*TABLES, MANIFEST_FILE):
        pending(store, name).unlink(missing_ok=True)
