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
    FLOAT_LIST,
    MAX_ROW_GROUP_SEGMENTS,
    MIN_ROW_GROUP_SEGMENTS,
    PART_BYTES,
    SEGMENTS,
    part_name,
    segment_writer_options,
)


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
        self._pending: list[Segment] = []
        self._sink: pa.NativeFile | None = None
        self._writer: pq.ParquetWriter | None = None

    @property
    def position(self) -> tuple[int, int]:
        """Number of the part and the row in it at which the next segment goes."""
        return self._number, self._rows_written + len(self._pending)

    def add_sequence(self, segments: Iterable[Segment]) -> None:
        """Append the segments of one sequence."""
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
        self._writer.write_table(_segment_table(self._pending), row_group_size=len(self._pending))
        self._rows_written += len(self._pending)
        self._pending.clear()


def _segment_table(segments: list[Segment]) -> pa.Table:
    columns = [
        array_of([segment.sequence_index for segment in segments], pa.int32()),
        array_of([segment.start_frame for segment in segments], pa.int32()),
        array_of([segment.num_frames for segment in segments], pa.int16()),
        _float_lists([segment.joint_positions for segment in segments]),
        _float_lists([segment.joint_rotations for segment in segments]),
        _float_lists([segment.root_translation for segment in segments]),
    ]
    return pa.Table.from_arrays(columns, schema=SEGMENTS)


def _float_lists(arrays: list[Float32[np.ndarray, "_"] | None]) -> pa.Array:
    present = [array for array in arrays if array is not None]
    values = np.concatenate(present) if present else np.empty(0, np.float32)
    return float_lists(values, [None if array is None else array.size for array in arrays], FLOAT_LIST)
