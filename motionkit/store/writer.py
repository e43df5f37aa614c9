"""Writes a store: parts, and tables under pending names; when all are on disk, the manifest, which commits them."""

import hashlib
import os
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from motionkit.core import files
from motionkit.core.errors import StoreError
from motionkit.core.files import defer_signals
from motionkit.core.motion import Motion
from motionkit.core.skeleton import Skeleton
from motionkit.store import codec
from motionkit.store.codec import EncodedMotion, RefusedMotion, encode, table_of
from motionkit.store.commit import (
    EMPTY,
    changing,
    describe_pending,
    pending,
    publish,
    write_pending,
)
from motionkit.store.manifest import FileEntry, Manifest
from motionkit.store.parts import PartWriter, PendingPart
from motionkit.store.reader import not_committed, open_table
from motionkit.store.same_skeletons import SameSkeletons
from motionkit.store.schema import (
    PART_BYTES,
    SEQUENCES,
    SEQUENCES_FILE,
    SEQUENCES_PER_ROW_GROUP,
    SKELETONS,
    SKELETONS_FILE,
    part_name,
    table_writer_options,
)
from motionkit.store.table_checks import CHECKED_COLUMNS, require_sound

# Number of ids kept as text before they are merged into the sorted ones.
RECENT = 4096
DTYPE = np.dtype([("id", "<u8"), ("id_rest", "<u8"), ("source", "<u8")])


class KnownSequences:
    """Ids and the checksums of their sources, as digests: 128 bits of an id, 64 of its source's checksum."""

    def __init__(self) -> None:
        self._recent: dict[str, str] = {}
        self._sorted = np.empty(0, DTYPE)

    def add(self, sequence_id: str, source_sha256: str) -> None:
        """Adds a sequence that is not in the index yet."""
        self._recent[sequence_id] = source_sha256
        if len(self._recent) == RECENT:
            self._merge(self._recent.items())
            self._recent.clear()

    def add_all(self, sequences: Iterable[tuple[str, str]]) -> None:
        """Adds many pairs of an id and its source's checksum."""
        self._merge(sequences)

    def __contains__(self, sequence_id: str) -> bool:
        return sequence_id in self._recent or self._find(sequence_id) is not None

    def is_from(self, sequence_id: str, source_sha256: str) -> bool:
        """Whether this sequence is known, and comes from a file with this checksum."""
        if sequence_id in self._recent:
            return self._recent[sequence_id] == source_sha256
        found = self._find(sequence_id)
        return found is not None and int(found["source"]) == _digest(source_sha256)[0]

    def _find(self, sequence_id: str) -> np.void | None:
        first, rest = _digest(sequence_id)
        places = (np.searchsorted(self._sorted["id"], np.uint64(first), side) for side in ("left", "right"))
        for entry in self._sorted[slice(*places)]:
            if int(entry["id_rest"]) == rest:
                found: np.void = entry
                return found
        return None

    def _merge(self, sequences: Iterable[tuple[str, str]]) -> None:
        more = np.array([(*_digest(name), _digest(source)[0]) for name, source in sequences], DTYPE)
        both = np.concatenate((self._sorted, more))
        # Two runs of which the first is sorted: a stable sort is little more than their merge.
        self._sorted = both[np.argsort(both["id"], kind="stable")]


def _digest(text: str) -> tuple[int, int]:
    content = hashlib.blake2b(text.encode("utf-8", "surrogatepass"), digest_size=16).digest()
    return int.from_bytes(content[:8], "little"), int.from_bytes(content[8:], "little")


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
        self._known = KnownSequences()
        self._skeletons: dict[str, Skeleton] = {}
        self._same_skeletons = SameSkeletons()

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
            self._base = self._previous if self._keep else EMPTY
            self._open()
            self._held = held.pop_all()
        return self

    def _open(self) -> None:
        if self._base is not EMPTY:
            self._read_base()
        self._part: PartWriter | None = None
        self._parts: dict[str, FileEntry] = {}
        self._next_part = self._previous.next_part
        self._rows: list[codec.Row] = []
        self._table: pq.ParquetWriter | None = None
        self._num_sequences = self._base.num_sequences
        self._num_segments = self._base.num_segments
        self._num_frames = self._base.num_frames
        self._next_sequence_index = self._base.next_sequence_index

    def _read_base(self) -> None:
        sequences = self._base_table(SEQUENCES_FILE, (*CHECKED_COLUMNS, "source_sha256"))
        skeletons = self._base_table(SKELETONS_FILE)
        self._skeletons = require_sound(self.path, self._base, sequences, skeletons)
        self._same_skeletons = SameSkeletons(self._skeletons.values())
        for batch in sequences.select(["sequence_id", "source_sha256"]).to_batches(SEQUENCES_PER_ROW_GROUP):
            self._known.add_all(zip(*(column.to_pylist() for column in batch.columns), strict=True))

    def _base_table(self, name: str, columns: Sequence[str] | None = None) -> pa.Table:
        table = open_table(self.path, self._base, name, columns)
        if table is None:
            raise not_committed(self.path)
        return table

    @property
    def num_sequences(self) -> int:
        """Number of sequences that the store will hold at the commit."""
        return self._num_sequences

    @property
    def skeletons(self) -> tuple[Skeleton, ...]:
        """All skeletons that the store will hold at the commit, in the order in which they came."""
        return tuple(self._skeletons.values())

    def knows_skeleton(self, skeleton: Skeleton) -> bool:
        """Whether the store will hold a skeleton that is equal but for its name, and lengths by less than 1 µm."""
        return self._same_skeletons.first_of(skeleton).fingerprint in self._skeletons

    @property
    def next_sequence_index(self) -> int:
        """A number that no sequence of the store has or had, and no greater one either."""
        return self._next_sequence_index

    def holds(self, sequence_id: str) -> bool:
        """Whether the store will hold a sequence with this id."""
        return sequence_id in self._known

    def holds_from(self, sequence_id: str, source_sha256: str) -> bool:
        """Whether the store will hold this sequence, read from a source with this checksum."""
        return bool(source_sha256) and self._known.is_from(sequence_id, source_sha256)

    def add(self, motion: Motion) -> int:
        """Add one motion and return its sequence index; raises `RefusedMotion` and leaves everything as it was."""
        return self.add_encoded(encode(motion))

    def add_encoded(self, motion: EncodedMotion) -> int:
        """Adds an encoded motion; otherwise as `add`."""
        self._require_new(motion.sequence_id)
        sequence_index = self._next_sequence_index
        if self._part is None:
            self._part = PartWriter(pending(self.path, part_name(self._next_part)))
        first_row = self._part.add(sequence_index, motion.runs)
        place = {"sequence_index": sequence_index, "part": self._next_part, "first_row": first_row}
        self.add_row({**motion.row, **place}, motion.skeleton)
        if self._part.reaches(self._part_bytes):
            self._finish_part()
        return sequence_index

    def add_part(self, part: PendingPart) -> int:
        """Take a part that is complete and lies among the store's; its number. Its sequences come by `add_row`."""
        number, name = self._next_part, part_name(self._next_part)
        if os.path.lexists(self.path / name):
            raise StoreError(
                f"{self.path / name} is there already, and is not written over: 'motionkit validate' says more"
            )
        files.replace(part.path, self.path / name)
        self._parts[name] = part.entry
        self._next_part += 1
        return number

    def add_row(self, row: codec.Row, skeleton: Skeleton) -> None:
        """Add a sequence whose segments are written: its row of the table, whole, with an index above all others."""
        self._require_new(row["sequence_id"])
        skeleton = self._same_skeletons.first_of(skeleton)
        self._rows.append({**row, "skeleton": skeleton.fingerprint})
        self._known.add(row["sequence_id"], row["source_sha256"])
        self._skeletons.setdefault(skeleton.fingerprint, skeleton)
        self._num_sequences += 1
        self._next_sequence_index = row["sequence_index"] + 1
        self._num_segments += row["num_segments"]
        self._num_frames += row["num_frames"]
        if len(self._rows) == SEQUENCES_PER_ROW_GROUP:
            self._flush_rows()

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
        elif self._num_sequences > self._base.num_sequences or not self._keep:
            with self._held:
                self._commit()
        else:
            self._held.close()

    def _commit(self) -> None:
        try:
            self._finish_part()
            self._flush_rows()
            publish(self.path, self._write_tables())
        finally:
            self._close()

    def _write_tables(self) -> Manifest:
        self._close_table()
        skeletons = table_of([codec.skeleton_row(each) for each in self._skeletons.values()], SKELETONS)
        write_pending(self.path, SKELETONS_FILE, skeletons)
        num_rows = {SEQUENCES_FILE: self._num_sequences, SKELETONS_FILE: len(self._skeletons)}
        parts = {name: self._base.files[name] for name in self._base.parts} | self._parts
        return Manifest(
            num_sequences=self._num_sequences,
            num_segments=self._num_segments,
            num_frames=self._num_frames,
            num_skeletons=len(self._skeletons),
            files=parts | describe_pending(self.path, num_rows),
            next_sequence_index=self._next_sequence_index,
            next_part=self._next_part,
        )

    def _flush_rows(self) -> None:
        path = pending(self.path, SEQUENCES_FILE)
        with files.naming(path):
            if self._table is None:
                files.create(path)
                self._table = pq.ParquetWriter(path, SEQUENCES, **table_writer_options())
                if self._base is not EMPTY:
                    for batch in pq.ParquetFile(self.path / SEQUENCES_FILE).iter_batches(SEQUENCES_PER_ROW_GROUP):
                        self._table.write_batch(batch)
            if self._rows:
                self._table.write_table(table_of(self._rows, SEQUENCES))
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
