"""Writes a store: parts, and tables under pending names; when all are on disk, the manifest, which commits them."""

import os
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

import pyarrow as pa
import pyarrow.parquet as pq

from motionkit.core import files
from motionkit.core.errors import StoreError
from motionkit.core.files import SEQUENCES_FILE, defer_signals
from motionkit.core.motion import Motion
from motionkit.core.skeleton import Skeleton
from motionkit.store.commit import (
    FileEntry,
    Manifest,
    changing,
    damaged,
    finished_entry,
    pending,
    publish,
    read_skeletons,
    read_table,
    write_pending,
)
from motionkit.store.schema import (
    MOTIONS,
    PART_BYTES,
    PART_OPTIONS,
    ROW_GROUP_FRAMES,
    SEQUENCES,
    SEQUENCES_PER_ROW_GROUP,
    SKELETONS,
    SKELETONS_FILE,
    TABLE_OPTIONS,
    EncodedMotion,
    RefusedMotion,
    Row,
    encode,
    part_name,
    same_body,
    skeleton_row,
)


@dataclass(frozen=True)
class PendingPart:
    """A complete part on disk, under its pending name."""

    path: Path
    entry: FileEntry


class PartWriter:
    """Writes one part to `path`, which must not exist; the file is created with its first row group.

    A row group ends with the sequence that brings it to 2,048 frames, so memory is bounded by one row group; a longer
    sequence has one of its own.
    """

    def __init__(self, path: Path) -> None:
        self.num_rows = 0
        self._path = path
        self._rows: list[pa.RecordBatch] = []
        self._num_frames = 0
        self._writer: pq.ParquetWriter | None = None

    def add(self, sequence_index: int, motion: EncodedMotion) -> int:
        """Append the frames of one sequence and return its row; raises `OSError` that names the file."""
        num_frames = motion.row["num_frames"]
        if num_frames >= ROW_GROUP_FRAMES:
            self._write_row_group()
        index = pa.array([sequence_index], pa.int32())
        self._rows.append(pa.RecordBatch.from_arrays([index, *motion.frames.columns], schema=MOTIONS))
        self._num_frames += num_frames
        self.num_rows += 1
        if self._num_frames >= ROW_GROUP_FRAMES:
            self._write_row_group()
        return self.num_rows - 1

    def reaches(self, num_bytes: int) -> bool:
        """Whether the part has at least so many bytes and no open row group, so that it can be closed."""
        return self._writer is not None and not self._rows and self._path.stat().st_size >= num_bytes

    def finish(self) -> PendingPart | None:
        """Complete the part and flush it to the disk; None if nothing was added."""
        self._write_row_group()
        if self._writer is None:
            return None
        with files.naming(self._path):
            self._writer.close()
        self._writer = None
        return PendingPart(self._path, finished_entry(self._path, self.num_rows))

    def abandon(self) -> None:
        """Close the file as it is; it is deleted when the writer's lock is released."""
        writer, self._writer, self._rows = self._writer, None, []
        if writer is not None:
            with suppress(OSError):  # the disk may be full
                writer.close()

    def _write_row_group(self) -> None:
        if not self._rows:
            return
        with files.naming(self._path):
            if self._writer is None:
                files.create(self._path)
                self._writer = pq.ParquetWriter(self._path, MOTIONS, **PART_OPTIONS)
            self._writer.write_table(pa.Table.from_batches(self._rows, MOTIONS).combine_chunks())
        self._rows, self._num_frames = [], 0


class StoreWriter:
    """Adds motions to a store, all or none: leaving the `with` block commits, an exception leaves the store as it was.

    Owns the writer's lock, the new parts and the new tables. One process writes at a time; readers go on reading.

    >>> with mk.StoreWriter.create("walks") as writer:
    ...     index = writer.add(mk.read("walk.bvh"))
    >>> list(mk.Store.open("walks"))
    ['captures/walk']
    """

    def __init__(self, path: Path, *, keep: bool, new: bool, part_bytes: int) -> None:
        self.path = path
        self._keep = keep
        self._new = new
        self._part_bytes = part_bytes
        self._held = ExitStack()

    @classmethod
    def create(cls, path: Path | str, *, overwrite: bool = False, part_bytes: int = PART_BYTES) -> "StoreWriter":
        """A writer of a new store; with `overwrite`, what was there is replaced at the commit and not before."""
        return cls(Path(path), keep=False, new=not overwrite, part_bytes=part_bytes)

    @classmethod
    def append(cls, path: Path | str, *, part_bytes: int = PART_BYTES) -> "StoreWriter":
        """A writer that adds to an existing store: new parts, a new table of sequences; old parts stay untouched."""
        return cls(Path(path), keep=True, new=False, part_bytes=part_bytes)

    def __enter__(self) -> "StoreWriter":
        """Take the lock and clean up; raises `BusyError`, or `StoreError` for a missing or present store."""
        with ExitStack() as held:
            self._previous = held.enter_context(
                changing(self.path, must_exist=self._keep, must_not_exist=self._new),
            )
            self._base = base = self._previous if self._keep else Manifest()
            self._source_of: dict[str, str] = {}
            self._skeletons: dict[str, Skeleton] = {}
            self._part: PartWriter | None = None
            self._parts: dict[str, FileEntry] = {}
            self._next_part = self._previous.next_part
            self._rows: list[Row] = []
            self._table: pq.ParquetWriter | None = None
            # A number that no sequence of the store has or had, and no greater one either.
            self.next_sequence_index = base.next_sequence_index
            if base.files:
                try:
                    columns = read_table(self.path, base, SEQUENCES_FILE, ("sequence_id", "source_sha256")).columns
                    self._skeletons = read_skeletons(read_table(self.path, base, SKELETONS_FILE))
                except (FileNotFoundError, ValueError) as error:
                    raise damaged(self.path, error) from None
                self._source_of = dict(zip(*(column.to_pylist() for column in columns), strict=True))
            self.former_sources = frozenset(self._source_of.values()) - {""}
            self._bodies = {same_body(each): fingerprint for fingerprint, each in self._skeletons.items()}
            self._held = held.pop_all()
        return self

    @property
    def num_sequences(self) -> int:
        """Number of sequences that the store will hold at the commit."""
        return len(self._source_of)

    def holds(self, sequence_id: str) -> bool:
        """Whether the store will hold a sequence with this id."""
        return sequence_id in self._source_of

    def holds_from(self, sequence_id: str, source_sha256: str) -> bool:
        """Whether the store will hold this sequence, read from a source with this checksum."""
        return bool(source_sha256) and self._source_of.get(sequence_id) == source_sha256

    def add(self, motion: Motion) -> int:
        """Add one motion and return its sequence index; raises `RefusedMotion` and leaves everything as it was."""
        return self.add_encoded(encode(motion))

    def add_encoded(self, motion: EncodedMotion) -> int:
        """Adds an encoded motion; otherwise as `add`."""
        self._require_new(motion.row["sequence_id"])
        sequence_index = self.next_sequence_index
        if self._part is None:
            self._part = PartWriter(pending(self.path, part_name(self._next_part)))
        part_row = self._part.add(sequence_index, motion)
        place = {"sequence_index": sequence_index, "part": self._next_part, "part_row": part_row}
        self.add_row({**motion.row, **place}, motion.skeleton)
        if self._part.reaches(self._part_bytes):
            self._finish_part()
        return sequence_index

    def add_part(self, part: PendingPart) -> int:
        """Add a complete part that lies in the store's folder of motions; returns its number.

        Its sequences are added by `add_row`.
        """
        number, name = self._next_part, part_name(self._next_part)
        if os.path.lexists(self.path / name):
            raise StoreError(
                f"{self.path / name} is there already, and is not written over: 'motionkit validate' says more"
            )
        files.replace(part.path, self.path / name)
        self._parts[name] = part.entry
        self._next_part += 1
        return number

    def add_row(self, row: Row, skeleton: Skeleton) -> None:
        """Add a sequence whose frames are written: its whole row of the table, with an index above all others."""
        self._require_new(row["sequence_id"])
        fingerprint = self._bodies.setdefault(same_body(skeleton), skeleton.fingerprint)
        self._skeletons.setdefault(fingerprint, skeleton)
        self._source_of[row["sequence_id"]] = row["source_sha256"]
        self.next_sequence_index = row["sequence_index"] + 1
        self._rows.append({**row, "skeleton": fingerprint})
        if len(self._rows) == SEQUENCES_PER_ROW_GROUP:
            self._write_rows()

    def _require_new(self, sequence_id: str) -> None:
        if self.holds(sequence_id):
            raise RefusedMotion(
                f"the store already holds a sequence with the id {sequence_id!r}: ids must differ",
                reason="duplicate-id",
            )

    def _finish_part(self) -> None:
        part = self._part.finish() if self._part is not None else None
        if part is not None:
            self.add_part(part)
        self._part = None

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        # An exception goes on to `changing`, which removes what was written.
        if kind is not None:
            with defer_signals():
                try:
                    self._close()  # also fails if the disk is full
                finally:
                    self._held.__exit__(kind, error, traceback)
        elif self.num_sequences > self._base.num_sequences or not self._keep:
            with self._held:
                self._commit()
        else:
            self._held.close()

    def _commit(self) -> None:
        try:
            self._finish_part()
            self._write_rows()
            self._close_table()
            skeletons = pa.Table.from_pylist(list(map(skeleton_row, self._skeletons.values())), SKELETONS)
            tables = {
                SEQUENCES_FILE: finished_entry(pending(self.path, SEQUENCES_FILE), self.num_sequences),
                SKELETONS_FILE: write_pending(self.path, SKELETONS_FILE, skeletons),
            }
            manifest = Manifest(
                files={**self._base.files, **self._parts, **tables},
                next_sequence_index=self.next_sequence_index,
                next_part=self._next_part,
            )
            publish(self.path, manifest)
        finally:
            self._close()

    def _write_rows(self) -> None:
        path = pending(self.path, SEQUENCES_FILE)
        with files.naming(path):
            if self._table is None:
                files.create(path)
                self._table = pq.ParquetWriter(path, SEQUENCES, **TABLE_OPTIONS)
                if self._base.files:
                    for batch in pq.ParquetFile(self.path / SEQUENCES_FILE).iter_batches(SEQUENCES_PER_ROW_GROUP):
                        self._table.write_batch(batch)
            if self._rows:
                self._table.write_table(pa.Table.from_pylist(self._rows, SEQUENCES))
                self._rows.clear()

    def _close_table(self) -> None:
        table, self._table = self._table, None
        if table is not None:
            with files.naming(pending(self.path, SEQUENCES_FILE)):
                table.close()

    def _close(self) -> None:
        if self._part is not None:
            self._part.abandon()
        self._close_table()
