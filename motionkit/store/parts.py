"""Parts: Parquet files with the frames of sequences, a row for each, in row groups of some thousand frames."""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from motionkit.core import files
from motionkit.core.errors import StoreError
from motionkit.core.shapes import Float32, Int64
from motionkit.store.commit import FileEntry, finished_entry, read_manifest
from motionkit.store.schema import (
    FRAME_COLUMNS,
    KEY_COLUMNS,
    MOTIONS,
    ROW_GROUP_FRAMES,
    EncodedMotion,
    frame_shapes,
    part_name,
    part_writer_options,
)

# An open part is its footer: about 500 bytes for each row group. A decoded row group is some megabytes.
KEPT_PARTS = 32
KEPT_ROW_GROUPS = 2


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
        if motion.num_frames >= ROW_GROUP_FRAMES:
            self._write_row_group()
        index = pa.array([sequence_index], pa.int32())
        self._rows.append(pa.RecordBatch.from_arrays([index, *motion.frames.columns], schema=MOTIONS))
        self._num_frames += motion.num_frames
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
                self._writer = pq.ParquetWriter(self._path, MOTIONS, **part_writer_options())
            self._writer.write_table(pa.Table.from_batches(self._rows, MOTIONS).combine_chunks())
        self._rows, self._num_frames = [], 0


@dataclass(frozen=True, eq=False)
class _Part:
    file: pq.ParquetFile
    row_group_starts: Int64[np.ndarray, "row_groups_and_end"]


class PartReader:
    """Owns the open parts and the decoded row groups of one committed state of a store."""

    def __init__(self, store: Path, entries: Mapping[str, FileEntry]) -> None:
        self._store = store
        self._entries = entries
        self._intact: set[str] = set()
        # Not of methods: with a reader all that it keeps is freed at once.
        self._opened = lru_cache(KEPT_PARTS)(_open)
        self._decoded = lru_cache(KEPT_ROW_GROUPS)(_decode)

    def read(
        self, row: Mapping[str, Any], *, rotations: bool = True
    ) -> dict[str, Float32[np.ndarray, "frames *channels"]]:
        """The frame arrays [num_frames, …] of a row of SEQUENCES; of the positions alone without `rotations`.

        Raises `StoreError` where the part is damaged, or gone since the store was opened.
        """
        try:
            frames = self._row(row, FRAME_COLUMNS if rotations else FRAME_COLUMNS[:1])
            return {
                name: _frames(frames, name, row["num_frames"], shape)
                for name, shape in frame_shapes(row, rotations=rotations).items()
            }
        except (pa.ArrowException, OSError, ValueError, MemoryError) as error:
            raise self._explained(row, error) from None

    def read_encoded(self, row: Mapping[str, Any]) -> pa.RecordBatch:
        """The row of MOTIONS of a row of SEQUENCES without its index, to be copied; raises as `read` does."""
        try:
            return self._row(row, FRAME_COLUMNS).drop_columns("sequence_index").to_batches()[0]
        except (pa.ArrowException, OSError, ValueError, MemoryError) as error:
            raise self._explained(row, error) from None

    def checked_path(self, name: str) -> Path:
        """Path of a part, whose sha256 is compared with the manifest's the first time.

        Raises `StoreError` if it is damaged, `OSError` if it cannot be read.
        """
        path, entry = self._store / name, self._entries[name]
        if name in self._intact:
            return path
        if path.stat().st_size != entry.num_bytes or files.sha256_of(path) != entry.sha256:
            raise StoreError(
                f"{path} is damaged (it is not the file that the manifest names): 'motionkit validate --store "
                f"{self._store}' says what is; restore it from a copy, or ingest the sources into a new store"
            )
        self._intact.add(name)
        return path

    def _row(self, row: Mapping[str, Any], columns: tuple[str, ...]) -> pa.Table:
        part = self._opened(self.checked_path(part_name(row["part"])))
        place, starts = row["part_row"], part.row_group_starts
        if not 0 <= place < starts[-1]:
            raise ValueError("the part has no such row")
        group = int(np.searchsorted(starts, place, side="right")) - 1
        frames = self._decoded(part.file, group, columns).slice(place - int(starts[group]), 1)
        for name in KEY_COLUMNS:
            if frames[name][0].as_py() != row[name]:
                raise ValueError(f"its {name} is not what the table of sequences says")
        return frames

    def _explained(self, row: Mapping[str, Any], error: Exception) -> StoreError:
        name = part_name(row["part"])
        if isinstance(error, FileNotFoundError):
            check_still_there(self._store, [name])
        return StoreError(
            f"the frames of sequence {row['sequence_id']!r} cannot be read from {name} "
            f"({' '.join(str(error).split())}): 'motionkit validate --store {self._store}' says what is damaged"
        )


def check_still_there(store: Path, parts: Iterable[str]) -> None:
    """Raise `StoreError` if a later state of the store doesn't use these parts, so that they were deleted."""
    if not set(parts) <= set(read_manifest(store).files):
        raise StoreError(
            f"the store {store} was written anew after it was opened (compacted, overwritten, or sequences "
            "removed): open it again"
        )


def _open(path: Path) -> _Part:
    file = pq.ParquetFile(path)
    if not file.schema_arrow.equals(MOTIONS):
        raise ValueError("its columns are not those of a part")
    counts = [file.metadata.row_group(group).num_rows for group in range(file.metadata.num_row_groups)]
    return _Part(file, np.cumsum([0, *counts], dtype=np.int64))


def _decode(file: pq.ParquetFile, group: int, columns: tuple[str, ...]) -> pa.Table:
    return file.read_row_group(group, columns=[*KEY_COLUMNS, *columns]).combine_chunks()


def _frames(
    row: pa.Table, name: str, num_frames: int, shape: tuple[int, ...]
) -> Float32[np.ndarray, "frames *channels"]:
    """A frame array out of its channel-major list; raises `ValueError` for another number of values."""
    values = row[name].combine_chunks().flatten().to_numpy()
    if values.size != num_frames * np.prod(shape):
        raise ValueError(f"{name} are {values.size} numbers, expected {num_frames} frames of {shape}")
    return np.ascontiguousarray(values.reshape(-1, num_frames).T).reshape(num_frames, *shape)
