"""Segments → immutable part files: row groups of 16–32 segments, sequences contiguous and within one part."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Float32

from motionkit.store import files
from motionkit.store.codec import Segment
from motionkit.store.columns import array_of, float_lists
from motionkit.store.manifest import PENDING_SUFFIX, FileEntry, describe_file
from motionkit.store.schema import (
    FLOAT_COLUMNS,
    FLOAT_LIST,
    KEY_COLUMNS,
    MAX_ROW_GROUP_SEGMENTS,
    MIN_ROW_GROUP_SEGMENTS,
    PART_BYTES,
    SEGMENTS,
    part_name,
    segment_writer_options,
)


class _FloatLists:
    """A column of lists as it fills: values one after the other, in memory that the next row group uses again."""

    def __init__(self) -> None:
        self._values = np.empty(0, np.float32)
        self._num_values = 0
        self._lengths: list[int | None] = []

    def append(self, values: Float32[np.ndarray, "_"] | None) -> None:
        """Copy one list's values; None is null."""
        self._lengths.append(None if values is None else values.size)
        if values is None:
            return
        end = self._num_values + values.size
        if end > self._values.size:
            grown = np.empty(2 * end, np.float32)
            grown[: self._num_values] = self._values[: self._num_values]
            self._values = grown
        self._values[self._num_values : end] = values
        self._num_values = end

    def array(self) -> pa.Array:
        """The lists so far; good until the next one is appended."""
        return float_lists(self._values[: self._num_values], self._lengths, FLOAT_LIST)

    def clear(self) -> None:
        """Forget all lists, but not their memory."""
        self._num_values = 0
        self._lengths.clear()


class _RowGroup:
    """Segments of the row group that is being filled, column by column."""

    def __init__(self) -> None:
        self._keys: list[tuple[int, int, int]] = []
        self._floats = tuple(_FloatLists() for _ in FLOAT_COLUMNS)

    def __len__(self) -> int:
        return len(self._keys)

    def append(self, segment: Segment) -> None:
        """Copy one segment."""
        self._keys.append((segment.sequence_index, segment.start_frame, segment.num_frames))
        arrays = (segment.joint_positions, segment.joint_rotations, segment.root_translation)
        for column, values in zip(self._floats, arrays, strict=True):
            column.append(values)

    def table(self) -> pa.Table:
        """All segments; good until the next one is appended."""
        keys = zip(zip(*self._keys, strict=True), KEY_COLUMNS, strict=True)
        columns = [array_of(values, SEGMENTS.field(name).type) for values, name in keys]
        return pa.Table.from_arrays([*columns, *(column.array() for column in self._floats)], schema=SEGMENTS)

    def clear(self) -> None:
        """Forget all segments, but not their memory."""
        self._keys.clear()
        for column in self._floats:
            column.clear()


class PartWriter:
    """Owns the part being written and the row group being filled; finished parts are in `finished`.

    A row group ends at the first sequence boundary after 16 segments, or after 32 inside a long sequence; a part ends
    at the first such boundary after `part_bytes`. So memory is bounded by one row group.
    """

    def __init__(self, store: Path, first_number: int, part_bytes: int = PART_BYTES) -> None:
        self.finished: dict[str, FileEntry] = {}
        self._store = store
        self._part_bytes = part_bytes
        self._number = first_number
        self._rows_written = 0
        self._pending = _RowGroup()
        self._sink: pa.NativeFile | None = None
        self._writer: pq.ParquetWriter | None = None

    @property
    def position(self) -> tuple[int, int]:
        """Number of the part and the row in it at which the next segment goes."""
        return self._number, self._rows_written + len(self._pending)

    def add_sequence(self, segments: Iterable[Segment]) -> None:
        """Append the segments of one sequence; their arrays are copied."""
        for segment in segments:
            self._pending.append(segment)
            if len(self._pending) == MAX_ROW_GROUP_SEGMENTS:
                self._write_row_group()
        if len(self._pending) >= MIN_ROW_GROUP_SEGMENTS:
            self._write_row_group()
        if self._sink is not None and not self._pending and self._sink.tell() >= self._part_bytes:
            self.finish()

    def finish(self) -> None:
        """Complete the part being written, if there is one."""
        if self._pending:
            self._write_row_group()
        if self._writer is None or self._sink is None:
            return
        self._writer.close()
        self._sink.close()
        name = part_name(self._number)
        pending = self._pending_path()
        entry = describe_file(pending, self._rows_written)
        files.replace(pending, self._store / name)
        self.finished[name] = entry
        self._writer = self._sink = None
        self._number += 1
        self._rows_written = 0

    def close(self) -> None:
        """Let go of the part being written, if there is one, as it is."""
        self._pending.clear()
        if self._writer is not None and self._sink is not None:
            self._writer.close()
            self._sink.close()
            self._writer = self._sink = None

    def _pending_path(self) -> Path:
        return self._store / (part_name(self._number) + PENDING_SUFFIX)

    def _write_row_group(self) -> None:
        if self._writer is None:
            self._sink = pa.OSFile(str(self._pending_path()), "wb")
            self._writer = pq.ParquetWriter(self._sink, SEGMENTS, **segment_writer_options())
        self._writer.write_table(self._pending.table(), row_group_size=len(self._pending))
        self._rows_written += len(self._pending)
        self._pending.clear()
