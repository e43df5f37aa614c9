"""Parts: Parquet files with the segments of sequences, in row groups of 16–31 segments."""

import hashlib
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from motionkit.core import files
from motionkit.core.errors import StoreError
from motionkit.core.files import sha256_of
from motionkit.core.shapes import Float32, Int64
from motionkit.store import codec
from motionkit.store.codec import RUN, array_of
from motionkit.store.manifest import FileEntry, describe_file, read_manifest
from motionkit.store.schema import (
    FLOAT_COLUMNS,
    KEY_COLUMNS,
    ROW_GROUP_SEGMENTS,
    SEGMENT_FRAMES,
    SEGMENTS,
    part_name,
    part_writer_options,
)

# Behind a Parquet file's metadata: their size, and these four bytes.
MAGIC = b"PAR1"
_END_BYTES = 8
# An open part is its footer: about 500 bytes for each row group. A decoded row group of long takes is 2 to 10 MB.
KEPT_PARTS = 32
KEPT_ROW_GROUPS = 4


@dataclass(frozen=True)
class PendingPart:
    """A complete part on disk, under its pending name."""

    path: Path
    entry: FileEntry


class PartWriter:
    """Writes one part to `path`, which must not exist; the file is created with its first row group.

    A row group ends with the run of segments that brings it to 16, so memory is bounded by one row group.
    """

    def __init__(self, path: Path) -> None:
        self.num_rows = 0
        self._path = path
        self._pending: list[pa.RecordBatch] = []
        self._num_pending = 0
        self._writer: pq.ParquetWriter | None = None

    def add(self, sequence_index: int, runs: Iterable[pa.RecordBatch]) -> int:
        """Append the segments of one sequence (`encode`) and return the row of the first.

        Raises `OSError` that names the file.
        """
        first_row = self.num_rows
        for run in runs:
            index = array_of([sequence_index] * run.num_rows, pa.int32())
            self._pending.append(pa.RecordBatch.from_arrays([index, *run.columns], schema=SEGMENTS))
            self.num_rows += run.num_rows
            self._num_pending += run.num_rows
            if self._num_pending >= ROW_GROUP_SEGMENTS:
                self._write_row_group()
        return first_row

    def reaches(self, num_bytes: int) -> bool:
        """Whether the part has at least so many bytes and no open row group, so that it can be closed."""
        return self._writer is not None and not self._pending and self._path.stat().st_size >= num_bytes

    def finish(self) -> PendingPart | None:
        """Completes the part and syncs it to disk; None if nothing was added."""
        if self._pending:
            self._write_row_group()
        if self._writer is None:
            return None
        with files.naming(self._path):
            self._writer.close()
        self._writer = None
        files.sync(self._path)
        footer_sha256 = hashlib.sha256(read_footer(self._path)).hexdigest()
        return PendingPart(self._path, replace(describe_file(self._path, self.num_rows), footer_sha256=footer_sha256))

    def abandon(self) -> None:
        """Closes the file as it is; it is deleted when the writer's lock is released."""
        self._pending = []
        writer, self._writer = self._writer, None
        if writer is not None:
            with suppress(OSError):  # the disk may be full
                writer.close()

    def _write_row_group(self) -> None:
        with files.naming(self._path):
            if self._writer is None:
                files.create(self._path)
                self._writer = pq.ParquetWriter(self._path, SEGMENTS, **part_writer_options())
            self._writer.write_table(pa.Table.from_batches(self._pending, SEGMENTS))
        self._pending = []
        self._num_pending = 0


def read_footer(path: Path) -> bytes:
    """The end of a Parquet file, which says where its pages lie; raises `ValueError` where there is none."""
    with files.naming(path), path.open("rb") as file:
        num_bytes = file.seek(0, os.SEEK_END)
        file.seek(max(0, num_bytes - _END_BYTES))
        end = file.read()
        length = int.from_bytes(end[:4], "little") + _END_BYTES
        if end[4:] != MAGIC or length > num_bytes:
            raise ValueError("it does not end as a Parquet file does")
        file.seek(num_bytes - length)
        return file.read()


@dataclass(frozen=True, eq=False)
class _Part:
    file: pq.ParquetFile
    row_group_starts: Int64[np.ndarray, "row_groups_and_end"]


class SegmentReader:
    """Owns the open parts and the decoded row groups of one committed state of a store."""

    def __init__(self, store: Path, entries: Mapping[str, FileEntry]) -> None:
        self._store = store
        self._entries = entries
        self._sound: set[str] = set()
        # Not of methods: with a reader all that it keeps is let go, at once.
        self._opened = lru_cache(KEPT_PARTS)(_open)
        self._decoded = lru_cache(KEPT_ROW_GROUPS)(_decode)

    def read(
        self, row: Mapping[str, Any], wanted: Mapping[str, tuple[int, ...]], decode: tuple[str, ...]
    ) -> dict[str, Float32[np.ndarray, "frames *channels"]]:
        """Arrays [num_frames, *shape] of the wanted columns of one sequence; `decode` are the columns to keep decoded.

        Raises `StoreError` where the part is damaged, or gone since the store was opened.
        """
        with self._explained(row):
            self._part(row)  # before so much memory is asked for
            out = {name: np.empty((row["num_frames"], *shape), np.float32) for name, shape in wanted.items()}
            for rows in self._rows(row, decode):
                _copy_segments(rows, out)
        return out

    def read_runs(self, row: Mapping[str, Any], wanted: Mapping[str, int]) -> list[pa.RecordBatch]:
        """The segments of one sequence as they are stored, without its number; `wanted` gives the columns' widths."""
        runs = []
        with self._explained(row):
            for rows in self._rows(row, FLOAT_COLUMNS):
                frames = rows["num_frames"].to_numpy().astype(np.int64)
                for name in FLOAT_COLUMNS:
                    _check_lengths(rows, name, frames * wanted[name] if name in wanted else None)
                runs += rows.select(RUN.names).to_batches()
        return runs

    def checked_part(self, name: str) -> Path:
        """Path of a part after verifying its footer against the manifest.

        Page checksums are verified on decoding; here it is the footer, or the whole file if pages have none (written by
        earlier versions), once per process. Raises `StoreError` if it is damaged, `FileNotFoundError` if it is gone.
        """
        path, entry = self._store / name, self._entries[name]
        if name in self._sound:
            return path
        intact = path.stat().st_size == entry.num_bytes
        if intact and entry.footer_sha256:
            intact = hashlib.sha256(read_footer(path)).hexdigest() == entry.footer_sha256
        elif intact:
            intact = sha256_of(path) == entry.sha256
        if not intact:
            raise StoreError(
                f"{path} is damaged (it is not the file that the manifest names): 'motionkit validate --store "
                f"{self._store}' says what is; restore it from a copy, or ingest the sources into a new store"
            )
        self._sound.add(name)
        return path

    def _part(self, row: Mapping[str, Any]) -> _Part:
        """The part of a sequence; raises `ValueError` where it has fewer rows than the sequence needs."""
        part = self._opened(self.checked_part(part_name(row["part"])))
        if not 0 <= row["first_row"] <= part.row_group_starts[-1] - row["num_segments"]:
            raise ValueError("the part ends before the sequence does")
        return part

    def _rows(self, row: Mapping[str, Any], columns: tuple[str, ...]) -> Iterator[pa.Table]:
        """The segments of one sequence, row group by row group."""
        first, last = row["first_row"], row["first_row"] + row["num_segments"]
        part = self._part(row)
        starts = part.row_group_starts
        while first < last:
            group = int(np.searchsorted(starts, first, side="right")) - 1
            table = self._decoded(part.file, group, columns)
            stop = min(last, int(starts[group + 1]))
            rows = table.slice(first - int(starts[group]), stop - first)
            _check_keys(rows, row, first - row["first_row"], stop - first)
            yield rows
            first = stop

    @contextmanager
    def _explained(self, row: Mapping[str, Any]) -> Iterator[None]:
        name = part_name(row["part"])
        try:
            yield
        except (pa.ArrowException, OSError, ValueError, IndexError, MemoryError) as error:
            if isinstance(error, FileNotFoundError):
                check_still_there(self._store, [name])
            raise StoreError(
                f"the frames of sequence {row['sequence_id']!r} cannot be read from {name} "
                f"({' '.join(str(error).split())}): "
                f"'motionkit validate --store {self._store}' says what is damaged"
            ) from None


def check_still_there(store: Path, parts: Iterable[str]) -> None:
    """Raises `StoreError` if a later state of the store doesn't use these parts, so that they were deleted."""
    if not set(parts) <= set(read_manifest(store).files):
        raise StoreError(
            f"the store {store} was written anew after it was opened (compacted, overwritten, or sequences "
            "removed): open it again"
        )


def _open(path: Path) -> _Part:
    file = pq.ParquetFile(path, page_checksum_verification=True)
    if not file.schema_arrow.equals(SEGMENTS):
        raise ValueError("its columns are not those of a part")
    counts = [file.metadata.row_group(group).num_rows for group in range(file.metadata.num_row_groups)]
    if min(counts, default=1) < 1:
        raise ValueError("it has a row group without rows")
    return _Part(file, np.cumsum([0, *counts], dtype=np.int64))


def _decode(file: pq.ParquetFile, group: int, columns: tuple[str, ...]) -> pa.Table:
    return file.read_row_group(group, columns=[*KEY_COLUMNS, *columns]).combine_chunks()


def _check_keys(rows: pa.Table, row: Mapping[str, Any], first_segment: int, num_segments: int) -> None:
    """Raise `ValueError` where rows are not these segments of a sequence."""
    start = SEGMENT_FRAMES * np.arange(first_segment, first_segment + num_segments)
    count = np.minimum(SEGMENT_FRAMES, row["num_frames"] - start)
    for name, expected in zip(KEY_COLUMNS, (np.full_like(start, row["sequence_index"]), start, count), strict=True):
        if not np.array_equal(rows[name].to_numpy(), expected):
            raise ValueError(f"{name} of its segments is not what the table of sequences says")


def _check_lengths(rows: pa.Table, name: str, lengths: Int64[np.ndarray, "segments"] | None) -> None:
    """Raise `ValueError` where a column's lists are not as long as they should be; None is null."""
    column = rows[name].chunk(0)
    if lengths is None:
        wrong = column.null_count != len(column)
    else:
        wrong = column.null_count > 0 or not np.array_equal(np.diff(column.offsets.to_numpy()), lengths)
    if wrong:
        raise ValueError(f"{name} does not have the numbers that its frames need")


def _values(rows: pa.Table, name: str) -> tuple[Float32[np.ndarray, "_"], Int64[np.ndarray, "_"]]:
    """A column's flat values and row offsets."""
    column = rows[name].chunk(0)
    return column.values.to_numpy(zero_copy_only=True), column.offsets.to_numpy()


def _copy_segments(rows: pa.Table, out: Mapping[str, Float32[np.ndarray, "frames *channels"]]) -> None:
    start, count = rows["start_frame"].to_numpy(), rows["num_frames"].to_numpy().astype(np.int64)
    for name, target in out.items():
        values, bounds = _values(rows, name)
        if (np.diff(bounds) != count * target[0].size).any():
            raise ValueError(f"{name} does not have {target[0].size} numbers for each frame")
        for i in range(len(start)):
            frames = target[start[i] : start[i] + count[i]]
            codec.write_frames(values[bounds[i] : bounds[i + 1]], int(count[i]), frames)
