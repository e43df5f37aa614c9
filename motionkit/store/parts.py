"""Segments of sequences → one Parquet part: row groups of 16–31 segments, sequences contiguous and within one part."""

import hashlib
import os
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from motionkit.core import files
from motionkit.store.codec import array_of
from motionkit.store.manifest import FileEntry, describe_file
from motionkit.store.schema import ROW_GROUP_SEGMENTS, SEGMENTS, part_writer_options

# Behind a Parquet file's metadata: their size, and these four bytes.
MAGIC = b"PAR1"
_END_BYTES = 8


@dataclass(frozen=True)
class PendingPart:
    """A part that is complete and on the disk, under the name that it has until its store takes it."""

    path: Path
    entry: FileEntry


class PartWriter:
    """Writes one part to `path`, where nothing may be; the file is made with its first row group.

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
        """Whether the part has so many bytes and no row group has been begun: the place to end it."""
        return self._writer is not None and not self._pending and self._path.stat().st_size >= num_bytes

    def finish(self) -> PendingPart | None:
        """Complete the part and bring it to the disk; None where nothing was added."""
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
        """Close the file as it is; the writer's lock deletes it."""
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
    with path.open("rb") as file:
        num_bytes = file.seek(0, os.SEEK_END)
        file.seek(max(0, num_bytes - _END_BYTES))
        end = file.read()
        length = int.from_bytes(end[:4], "little") + _END_BYTES
        if end[4:] != MAGIC or length > num_bytes:
            raise ValueError("it does not end as a Parquet file does")
        file.seek(num_bytes - length)
        return file.read()
