"""Writing a store: parts first, then the tables under pending names, then the manifest; its rename is the commit."""

from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

import pyarrow as pa
import pyarrow.parquet as pq

from motionkit.errors import StoreError
from motionkit.motion import Motion
from motionkit.skeleton import Skeleton
from motionkit.store import codec, files
from motionkit.store.encode import EncodedMotion, RefusedMotion, encode
from motionkit.store.manifest import (
    PENDING_SUFFIX,
    Manifest,
    commit_manifest,
    describe_file,
    read_manifest,
)
from motionkit.store.parts import PartWriter
from motionkit.store.schema import (
    FORMAT_VERSION,
    MANIFEST_FILE,
    PART_BYTES,
    SEGMENTS_FOLDER,
    SEQUENCES,
    SEQUENCES_FILE,
    SEQUENCES_PER_ROW_GROUP,
    SKELETONS,
    SKELETONS_FILE,
    part_number,
    table_writer_options,
)

TABLES = (SEQUENCES_FILE, SKELETONS_FILE)
EMPTY = Manifest(num_sequences=0, num_segments=0, num_frames=0, num_skeletons=0, files={})


class StoreWriter:
    """Adds motions to a store, all or none: leaving the `with` block commits, an exception leaves the store as it was.

    Owns the writer's lock, the new parts and the new tables. One process writes at a time; readers go on reading.
    """

    def __init__(self, path: Path, *, keep: bool, new: bool, part_bytes: int) -> None:
        self.path = path
        self._keep = keep
        self._new = new
        self._part_bytes = part_bytes
        self._held = ExitStack()
        self._known: dict[str, str] = {}
        self._skeletons: dict[str, Skeleton] = {}

    @classmethod
    def create(cls, path: Path | str, *, overwrite: bool = False, part_bytes: int = PART_BYTES) -> "StoreWriter":
        """A writer of a new store; with `overwrite`, what was there is replaced at the commit and not before."""
        return cls(Path(path), keep=False, new=not overwrite, part_bytes=part_bytes)

    @classmethod
    def append(cls, path: Path | str, *, part_bytes: int = PART_BYTES) -> "StoreWriter":
        """A writer that adds to an existing store: new parts, a new table of sequences; old parts stay untouched."""
        return cls(Path(path), keep=True, new=False, part_bytes=part_bytes)

    def __enter__(self) -> "StoreWriter":
        """Take the lock and tidy up; raises `StoreError` for a store that is busy, missing, present or not a store."""
        _check_target(self.path, must_exist=self._keep, must_not_exist=self._new)
        (self.path / SEGMENTS_FOLDER).mkdir(parents=True, exist_ok=True)
        with ExitStack() as held:
            held.enter_context(
                files.exclusive_lock(
                    self.path / files.LOCK_FILE,
                    busy=f"another process is writing to the store {self.path}: wait until it has ended",
                )
            )
            _check_target(self.path, must_exist=self._keep, must_not_exist=self._new)
            self._open()
            self._held = held.pop_all()
        return self

    def _open(self) -> None:
        self._previous = read_manifest(self.path) if (self.path / MANIFEST_FILE).exists() else EMPTY
        finish_commit(self.path, self._previous)
        remove_leftovers(self.path, self._previous)
        self._base = self._previous if self._keep else EMPTY
        if self._base.format_version != FORMAT_VERSION:
            raise StoreError(
                f"the store {self.path} has format version {self._base.format_version}, which can be read but not "
                f"added to: bring it to version {FORMAT_VERSION} with 'motionkit migrate --store {self.path}'"
            )
        if self._base is not EMPTY:
            self._read_base()
        numbers = [part_number(name) for name in self._previous.parts]
        self._parts = PartWriter(self.path, max(numbers, default=-1) + 1, self._part_bytes)
        self._rows: list[codec.Row] = []
        self._table: pq.ParquetWriter | None = None
        self._num_sequences = self._base.num_sequences
        self._num_segments = self._base.num_segments
        self._num_frames = self._base.num_frames

    def _read_base(self) -> None:
        known = pq.read_table(self.path / SEQUENCES_FILE, columns=["sequence_id", "source_sha256"])
        self._known = dict(
            zip(known["sequence_id"].to_pylist(), known["source_sha256"].to_pylist(), strict=True),
        )
        for row in pq.read_table(self.path / SKELETONS_FILE).to_pylist():
            self._skeletons[row["skeleton"]] = codec.skeleton_from_row(row)

    @property
    def num_sequences(self) -> int:
        """Number of sequences that the store will hold at the commit."""
        return self._num_sequences

    def source_sha256(self, sequence_id: str) -> str | None:
        """Checksum of the source that a sequence came from; None for an id that the store does not hold."""
        return self._known.get(sequence_id)

    def add(self, motion: Motion) -> int:
        """Add one motion and return its sequence index; raises `RefusedMotion` and leaves everything as it was."""
        return self.add_encoded(encode(motion))

    def add_encoded(self, motion: EncodedMotion) -> int:
        """Add a motion that another process may have encoded; otherwise as `add`."""
        if motion.sequence_id in self._known:
            raise RefusedMotion(
                f"the store already holds a sequence with the id {motion.sequence_id!r}: ids must differ",
                reason="duplicate-id",
            )
        sequence_index = self._num_sequences
        part, first_row = self._parts.position
        self._parts.add_sequence(motion.segments(sequence_index))
        self._rows.append(
            {**motion.row, "sequence_index": sequence_index, "part": part, "first_row": first_row},
        )
        self._known[motion.sequence_id] = motion.row["source_sha256"]
        self._skeletons.setdefault(motion.skeleton.fingerprint, motion.skeleton)
        self._num_sequences += 1
        self._num_segments += motion.row["num_segments"]
        self._num_frames += motion.num_frames
        if len(self._rows) == SEQUENCES_PER_ROW_GROUP:
            self._flush_rows()
        return sequence_index

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        with self._held:
            if kind is not None:
                self._discard()
            elif self._num_sequences > self._base.num_sequences or not self._keep:
                self._commit()

    def _commit(self) -> None:
        try:
            self._parts.finish()
            manifest = self._write_tables()
            commit_manifest(self.path, manifest)
        except BaseException:
            self._discard()
            raise
        finish_commit(self.path, manifest)
        remove_leftovers(self.path, manifest)

    def _write_tables(self) -> Manifest:
        self._flush_rows()
        assert self._table is not None
        self._table.close()
        self._table = None
        skeletons = pa.Table.from_pylist([codec.skeleton_row(each) for each in self._skeletons.values()], SKELETONS)
        pq.write_table(skeletons, self._pending(SKELETONS_FILE), **table_writer_options())
        entries = {name: self._base.files[name] for name in self._base.parts} | self._parts.finished
        for name, num_rows in ((SEQUENCES_FILE, self._num_sequences), (SKELETONS_FILE, len(self._skeletons))):
            files.sync_file(self._pending(name))
            entries[name] = describe_file(self._pending(name), num_rows)
        return Manifest(
            num_sequences=self._num_sequences,
            num_segments=self._num_segments,
            num_frames=self._num_frames,
            num_skeletons=len(self._skeletons),
            files=entries,
        )

    def _flush_rows(self) -> None:
        if self._table is None:
            self._table = pq.ParquetWriter(self._pending(SEQUENCES_FILE), SEQUENCES, **table_writer_options())
            if self._base is not EMPTY:
                for batch in pq.ParquetFile(self.path / SEQUENCES_FILE).iter_batches(SEQUENCES_PER_ROW_GROUP):
                    self._table.write_batch(batch)
        if self._rows:
            self._table.write_table(pa.Table.from_pylist(self._rows, SEQUENCES))
            self._rows.clear()

    def _pending(self, name: str) -> Path:
        return self.path / (name + PENDING_SUFFIX)

    def _discard(self) -> None:
        if self._table is not None:
            self._table.close()
            self._table = None
        if self._committed():
            return
        self._parts.discard()
        for name in (*TABLES, MANIFEST_FILE):
            self._pending(name).unlink(missing_ok=True)

    def _committed(self) -> bool:
        """Whether the manifest has been renamed: a fault after that must not remove what it names."""
        exists = (self.path / MANIFEST_FILE).exists()
        return (read_manifest(self.path) if exists else EMPTY) != self._previous


def finish_commit(store: Path, manifest: Manifest) -> None:
    """Give committed tables that still have their pending names their own; the caller holds the writer's lock."""
    for name in TABLES:
        pending = store / (name + PENDING_SUFFIX)
        if name in manifest.files and pending.exists() and files.sha256_of(pending) == manifest.files[name].sha256:
            files.replace(pending, store / name)


def remove_leftovers(store: Path, manifest: Manifest) -> None:
    """Remove what a killed writer left, and parts that are no longer part of the store; the caller holds the lock."""
    for name in (*TABLES, MANIFEST_FILE):
        (store / (name + PENDING_SUFFIX)).unlink(missing_ok=True)
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
