"""The lines of numbers of a BVH file, without holding its whole text in memory.

`read_tables` reads their numbers once, in order. `find_frame_lines` indexes and checks all of them for random access:
memory holds the byte offset of each frame's line (eight bytes per frame), and the few blocks of lines that were
accessed last.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

import numpy as np

from motionkit.core.errors import FormatError
from motionkit.core.shapes import Bool, Float64, Int64
from motionkit.io.bvh.text import BvhText
from motionkit.io.source import number_table
from motionkit.io.source.number_table import RowsFound, TablePart
from motionkit.io.source.source_file import FileParts, check_size

TABLE_FRAMES = 4096
FRAMES_AT_ONCE = 512
BLOCKS_KEPT = 6
_NAN = re.compile(rb"(?i)(?<![^\s])[-+]?nan(?![^\s])")


@dataclass(frozen=True, eq=False)
class FrameLines:
    """Lines of a file by frame. `starts[k]` is the byte offset of frame k's line; the last one is the end.

    `seen` marks the frames whose numbers are all finite: others repeat those of the last such frame, or of the first.
    """

    file: FileParts
    starts: Int64[np.ndarray, " frames_and_end"]
    num_columns: int
    seen: Bool[np.ndarray, "frames"]

    def __len__(self) -> int:
        return len(self.seen)

    def frames(self, start: int, stop: int) -> "FrameLines":
        """Frames [start, stop)."""
        return replace(self, starts=self.starts[start : stop + 1], seen=self.seen[start:stop])

    def line(self, frame: int) -> bytes:
        """The line of a frame as written, stripped of white space."""
        number, place = divmod(frame, FRAMES_AT_ONCE)
        return self._kept_block(number).lines[place]

    def table(self, frames: Int64[np.ndarray, "rows"]) -> Float64[np.ndarray, "rows channels"]:
        """The numbers of frames, in any order (file units, degrees)."""
        result = np.empty((len(frames), self.num_columns))
        numbers = frames // FRAMES_AT_ONCE
        for number in np.unique(numbers).tolist():
            here = np.flatnonzero(numbers == number)
            result[here] = self._kept_block(number).table[frames[here] - number * FRAMES_AT_ONCE]
        return result

    def tables(self) -> Iterator[Float64[np.ndarray, "some channels"]]:
        """The numbers of all frames, block by block."""
        for start in range(0, len(self), FRAMES_AT_ONCE):
            yield self.table(np.arange(start, min(start + FRAMES_AT_ONCE, len(self))))

    @cached_property
    def _kept_block(self) -> "Callable[[int], _Block]":
        return lru_cache(BLOCKS_KEPT)(self._block)

    def _block(self, number: int) -> "_Block":
        first, stop = number * FRAMES_AT_ONCE, min(len(self), (number + 1) * FRAMES_AT_ONCE)
        lines = self._lines(first, stop)
        whole = list(lines)
        for place in np.flatnonzero(~self.seen[first:stop]).tolist():
            source = int(self._sources[first + place])
            whole[place] = lines[source - first] if source >= first else self._lines(source, source + 1)[0]
        part = TablePart(1, 0, stop - first, is_end=True)
        rows = number_table.find_rows(b"\n".join(whole), self.num_columns, self.file.path, part)
        return _Block(lines, rows.table)

    def _lines(self, first: int, stop: int) -> tuple[bytes, ...]:
        starts = self.starts[first : stop + 1]
        data = self.file.read(int(starts[0]), int(starts[-1]))
        places = (starts - starts[0]).tolist()
        return tuple(data[start:end].strip() for start, end in pairwise(places))

    @cached_property
    def _sources(self) -> Int64[np.ndarray, "frames"]:
        whole = np.where(self.seen, np.arange(len(self)), int(np.argmax(self.seen)))
        return np.asarray(np.maximum.accumulate(whole))


@dataclass(frozen=True, eq=False)
class _Block:
    lines: tuple[bytes, ...]
    table: Float64[np.ndarray, "rows channels"]


def read_tables(file: FileParts, head: BvhText) -> Iterator[Float64[np.ndarray, "some channels"]]:
    """All frames' numbers (file units, degrees) in order, in tables of at least 4,096 frames except the last.

    Nothing is yielded for a file too small for the frames that it declares. Raises `FormatError`: `too-large` before
    the first table, for missing frames after the last, and otherwise as `number_table.find_rows` does.
    """
    end = file.end_of_text()
    # A number takes at least a digit and a separator.
    believed = 2 * head.num_frames * head.hierarchy.num_channels - 1 <= end - head.body_start
    if believed:
        check_size(head.num_frames, len(head.hierarchy.joints), file.path)
    waiting: list[Float64[np.ndarray, "some channels"]] = []
    for _, rows in _blocks_of_rows(file, head, end, number_table.find_rows):
        if believed:
            waiting.append(rows.table)
        if sum(map(len, waiting)) >= TABLE_FRAMES:
            yield np.concatenate(waiting)
            waiting = []
    if waiting:
        yield np.concatenate(waiting)


def find_frame_lines(file: FileParts, head: BvhText) -> FrameLines:
    """Find and check all lines of numbers; raises `FormatError` as `number_table.find_rows` does.

    Lines with `nan` are frames that are not seen; it is an error if all have it.
    """
    end = file.end_of_text()
    starts, seen = [], []
    for place, rows in _blocks_of_rows(file, head, end, _find_seen_rows):
        starts.append(rows.starts + place)
        seen.append(rows.seen)
    whole = checked_seen(np.concatenate(seen), file.path)
    return FrameLines(file, np.concatenate((*starts, [end])), head.hierarchy.num_channels, whole)


Rows = TypeVar("Rows", bound=RowsFound)


def _blocks_of_rows(
    file: FileParts, head: BvhText, end: int, find: Callable[[bytes, int, Path, TablePart], Rows]
) -> Iterator[tuple[int, Rows]]:
    """The byte offset of each block of lines, and the result of `find` for it; raises `FormatError` (`truncated`)."""
    line, found = head.body_line, 0
    for place, block in file.line_blocks(head.body_start, end, number_table.BLOCK_BYTES):
        part = TablePart(line, found, head.num_frames, is_end=place + len(block) == end)
        rows = find(block, head.hierarchy.num_channels, file.path, part)
        found += len(rows.starts)
        line += block.count(b"\n")
        yield place, rows
    if found < head.num_frames:
        raise number_table.too_few_rows(found, head.num_frames, file.path, line)


def checked_seen(seen: Bool[np.ndarray, "frames"], path: Path) -> Bool[np.ndarray, "frames"]:
    """The mask, unchanged; raises `FormatError` (`nan`) if no frame is seen."""
    if not seen.any():
        raise FormatError("every frame holds nan: nothing is observed", path=path, reason="nan")
    return seen


@dataclass(frozen=True, eq=False)
class _SeenRows(RowsFound):
    """Rows, and a mask of those without nan: the others need not be numbers."""

    seen: Bool[np.ndarray, "rows"]


def _find_seen_rows(block: bytes, num_columns: int, path: Path, part: TablePart) -> _SeenRows:
    if b"nan" not in block.lower() or _NAN.search(block) is None:
        rows = number_table.find_rows(block, num_columns, path, part)
        return _SeenRows(rows.table, rows.starts, np.ones(len(rows.starts), bool))
    lines = block.splitlines(keepends=True)
    there = np.array([bool(line.strip()) for line in lines], bool)
    starts = np.cumsum([0, *map(len, lines)])[:-1][there]
    seen = np.array([_NAN.search(line) is None for line in lines], bool)[there]
    # Lines with nan become zeros, so that the counts of lines and frames stay right.
    zeros = b" ".join([b"0"] * num_columns) + b"\n"
    clean = b"".join(zeros if _NAN.search(line) else line for line in lines)
    return _SeenRows(number_table.find_rows(clean, num_columns, path, part).table, starts, seen)
