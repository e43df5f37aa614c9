"""Frames out of parts: decoded by row group, of which the last few are kept."""

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Float32, Int64

from motionkit.core.checksums import sha256_of
from motionkit.core.errors import StoreError
from motionkit.core.files import require_regular
from motionkit.store import codec
from motionkit.store.encode import RUN
from motionkit.store.manifest import FileEntry, read_manifest
from motionkit.store.parts import read_footer
from motionkit.store.schema import FLOAT_COLUMNS, KEY_COLUMNS, SEGMENT_FRAMES, SEGMENTS, part_name

# An open part is its footer: about 500 bytes for each row group. A decoded row group of long takes is 2 to 10 MB.
KEPT_PARTS = 32
KEPT_ROW_GROUPS = 4

Key = TypeVar("Key")
Value = TypeVar("Value")


class _Latest(Generic[Key, Value]):
    """The few values that were asked for last."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._values: OrderedDict[Key, Value] = OrderedDict()

    def get(self, key: Key, make: Callable[[], Value]) -> Value:
        """The value of a key, made where it is not kept."""
        if key not in self._values:
            self._values[key] = make()
            if len(self._values) > self._size:
                self._values.popitem(last=False)
        self._values.move_to_end(key)
        return self._values[key]


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
        self._parts: _Latest[int, _Part] = _Latest(KEPT_PARTS)
        self._row_groups: _Latest[tuple[int, int, tuple[str, ...]], pa.Table] = _Latest(KEPT_ROW_GROUPS)

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
        """Path of a part that is what the manifest says, as far as its pages do not say it of themselves.

        Pages carry checksums, which are compared when they are decoded; here it is the footer, or the whole of a part
        whose pages have none (earlier versions wrote such), once in a process. Raises `StoreError` where it is damaged,
        `FileNotFoundError` where it is gone.
        """
        path, entry = self._store / name, self._entries[name]
        if name in self._sound:
            return path
        require_regular(path)
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
        part = self._parts.get(row["part"], lambda: self._open(row["part"]))
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
            table = self._row_groups.get((row["part"], group, columns), partial(_decode, part.file, group, columns))
            stop = min(last, int(starts[group + 1]))
            rows = table.slice(first - int(starts[group]), stop - first)
            _check_keys(rows, row, first - row["first_row"], stop - first)
            yield rows
            first = stop

    def _open(self, number: int) -> _Part:
        file = pq.ParquetFile(self.checked_part(part_name(number)), page_checksum_verification=True)
        if not file.schema_arrow.equals(SEGMENTS):
            raise ValueError("its columns are not those of a part")
        counts = [file.metadata.row_group(group).num_rows for group in range(file.metadata.num_row_groups)]
        if min(counts, default=1) < 1:
            raise ValueError("it has a row group without rows")
        return _Part(file, np.cumsum([0, *counts], dtype=np.int64))

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
    """Raise `StoreError` where a later state of the store has no use for these parts, so that they were deleted."""
    if not set(parts) <= set(read_manifest(store).files):
        raise StoreError(
            f"the store {store} was written anew after it was opened (compacted, migrated, overwritten, or sequences "
            "removed): open it again"
        )


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
    """A column's flat values, and the bounds of each row in them."""
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
