"""Compressed sequences → immutable parts: row groups of 16–31 segments, sequences contiguous and within one part."""

import hashlib
import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Int32

from motionkit.core import files
from motionkit.errors import StoreError
from motionkit.store.encode import EncodedMotion
from motionkit.store.flushing import Flushing
from motionkit.store.footer import MAGIC, Chunk, footer, row_group
from motionkit.store.manifest import PENDING_SUFFIX, FileEntry
from motionkit.store.pages import Page, Run, float_page, integer_page, segment_frames
from motionkit.store.schema import (
    FLOAT_COLUMNS,
    KEY_COLUMNS,
    PART_BYTES,
    ROW_GROUP_SEGMENTS,
    SEGMENT_FRAMES,
    SEGMENTS,
    part_name,
)
from motionkit.store.thrift import Value

# So much of a part goes to the disk at once, while the next bytes are being computed: at its end little is left to wait
# for.
FLUSHED_BYTES = 16 * 2**20


class _File:
    """Owns a file that is being written; knows how many bytes it has and their sha256."""

    def __init__(self, path: Path, flushing: Flushing) -> None:
        self.path = path
        self.num_bytes = 0
        self._sha256 = hashlib.sha256()
        files.create(path)
        self._file = path.open("wb")
        self._flushing = flushing
        self._flushed_bytes = 0

    def write(self, content: bytes) -> None:
        """Append bytes; raises `OSError` that names the file."""
        with files.naming(self.path):
            self._file.write(content)
        self._sha256.update(content)
        self.num_bytes += len(content)
        if self.num_bytes - self._flushed_bytes >= FLUSHED_BYTES:
            self._flushed_bytes = self.num_bytes
            self._flushing.begin(partial(files.sync, self.path))

    def close(self) -> str:
        """End it; the sha256 of all that was written, hex."""
        with files.naming(self.path):
            self._file.close()
        return self._sha256.hexdigest()


class _RowGroup:
    """The segments of the row group that is being filled: their keys, and runs of their frames."""

    def __init__(self) -> None:
        self._keys: list[Int32[np.ndarray, "3 _"]] = []
        self._runs: list[tuple[Run, ...]] = []
        self.num_rows = 0

    def append(self, keys: Int32[np.ndarray, "3 segments"], runs: Sequence[Run]) -> None:
        """Add segments that follow each other, and the run of each column of floats that holds them; all is copied."""
        self._keys.append(keys.copy())
        self._runs.append(tuple(run.copy() for run in runs))
        self.num_rows += keys.shape[1]

    def write_to(self, file: _File) -> Value:
        """Append one page for each column to the file; the row group's entry in the footer."""
        keys = np.concatenate(self._keys, axis=1)
        chunks = [_chunk(file, integer_page(key), (int(key.min()), int(key.max()))) for key in keys]
        for name, runs in zip(FLOAT_COLUMNS, zip(*self._runs, strict=True), strict=True):
            chunks.append(_chunk(file, float_page(runs, nullable=SEGMENTS.field(name).nullable)))
        return row_group(chunks, self.num_rows)


def _chunk(file: _File, page: Page, bounds: tuple[int, int] | None = None) -> Chunk:
    first_byte = file.num_bytes
    file.write(page.header)
    file.write(page.body)
    return Chunk(first_byte, file.num_bytes - first_byte, page.num_bytes_plain, page.num_values, bounds)


class PartWriter:
    """Owns the part being written and the row group being filled; finished parts are in `finished`.

    A row group ends with the run that brings it to 16 segments, a part with the sequence that ends such a row group
    when the part has `part_bytes`. So memory is bounded by one row group. Parts go to the disk while the next ones are
    written; after `settle` they are there, whole, under their names.
    """

    def __init__(self, store: Path, first_number: int, part_bytes: int = PART_BYTES) -> None:
        self.finished: dict[str, FileEntry] = {}
        self._store = store
        self._part_bytes = part_bytes
        self._number = first_number
        self._rows_written = 0
        self._pending = _RowGroup()
        self._file: _File | None = None
        self._row_groups: list[Value] = []
        self._flushing = Flushing()

    @property
    def position(self) -> tuple[int, int]:
        """Number of the part and the row in it at which the next segment goes."""
        return self._number, self._rows_written + self._pending.num_rows

    def add_sequence(self, sequence_index: int, motion: EncodedMotion) -> None:
        """Append the segments of one sequence."""
        keys = _keys(sequence_index, motion.num_frames)
        for runs in zip(*motion.columns, strict=True):
            self._pending.append(keys[:, : runs[0].num_rows], runs)
            keys = keys[:, runs[0].num_rows :]
            if self._pending.num_rows >= ROW_GROUP_SEGMENTS:
                self._write_row_group()
        if self._file is not None and not self._pending.num_rows and self._file.num_bytes >= self._part_bytes:
            self.finish()

    def finish(self) -> None:
        """Complete the part being written, if there is one."""
        if self._pending.num_rows:
            self._write_row_group()
        if self._file is None:
            return
        end = footer(self._row_groups, self._rows_written)
        self._file.write(end)
        sha256 = self._file.close()
        name = part_name(self._number)
        self._flushing.begin(partial(files.replace, self._file.path, self._store / name))
        footer_sha256 = hashlib.sha256(end).hexdigest()
        self.finished[name] = FileEntry(sha256, self._file.num_bytes, self._rows_written, footer_sha256)
        self._file = None
        self._row_groups.clear()
        self._number += 1
        self._rows_written = 0

    def settle(self) -> None:
        """Wait until all finished parts are on the disk; raises the `OSError` of one that could not be put there."""
        self._flushing.settle()

    def close(self) -> None:
        """Let go of the part being written, if there is one, as it is."""
        self._flushing.close()
        self._pending = _RowGroup()
        file, self._file = self._file, None
        if file is not None:
            file.close()

    def _write_row_group(self) -> None:
        if self._file is None:
            path = self._store / part_name(self._number)
            if os.path.lexists(path):
                raise StoreError(f"{path} is there already, and is not written over: 'motionkit validate' says more")
            self._file = _File(path.with_name(path.name + PENDING_SUFFIX), self._flushing)
            self._file.write(MAGIC)
        self._row_groups.append(self._pending.write_to(self._file))
        self._rows_written += self._pending.num_rows
        self._pending = _RowGroup()


def _keys(sequence_index: int, num_frames: int) -> Int32[np.ndarray, "3 segments"]:
    """The key columns of a sequence's segments."""
    lengths = segment_frames(num_frames)
    keys = {
        "sequence_index": np.full_like(lengths, sequence_index),
        "start_frame": SEGMENT_FRAMES * np.arange(len(lengths), dtype=np.int32),
        "num_frames": lengths,
    }
    return np.stack([keys[name] for name in KEY_COLUMNS])
