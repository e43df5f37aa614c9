"""Tables of numbers separated by white space: fast for regular tables, precise error messages for others.

The fast path finds all words of a block of lines with array operations, views them as Arrow's 16-byte string views
(https://arrow.apache.org/docs/format/Columnar.html, variable-size binary view layout) and casts these to float64 with
Arrow, so that no word becomes a Python object. Blocks that this fails to parse are parsed again line by line.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motionkit.core.errors import FormatError
from motionkit.core.shapes import Bool, Float64, Int32, Int64, UInt8

LARGEST_VALUE = 1e9
# A block and its word tables fit into a core's cache, and each is small enough for malloc to reuse its memory: from
# 128 KB on every table would be mapped anew, with a page fault for each 4 KB, a third of the time of parsing.
BLOCK_BYTES = 3 << 15
INLINE_BYTES = 12
LENGTH_BYTES = 4
VIEW_BYTES = LENGTH_BYTES + INLINE_BYTES
NEWLINE, SPACE = 10, 32
LONGEST_LINE_BYTES = 16 << 20


@dataclass(frozen=True)
class Words:
    """The words of a text: `padded` is the text with newlines before and after it, `starts` are offsets into it.

    `opens_line` marks the words that are the first of their line.
    """

    padded: bytes
    starts: Int64[np.ndarray, "words"]
    lengths: Int64[np.ndarray, "words"]
    opens_line: Bool[np.ndarray, "words"]

    def take(self, places: Int64[np.ndarray, "*shape"]) -> "Words":
        """The words at the indices `places`, in that order."""
        places = places.reshape(-1)
        return Words(self.padded, self.starts[places], self.lengths[places], self.opens_line[places])

    def inline(self) -> np.ndarray:
        """The first 12 bytes from each word's start, as one opaque value per word."""
        letters: np.ndarray = self._windows(INLINE_BYTES)[self.starts]
        return letters

    def views(self) -> Int32[np.ndarray, "words 4"]:
        """A string view for each word: its length, then its first 12 bytes."""
        # A window begins before its word, to leave room for the length.
        views: np.ndarray = self._windows(VIEW_BYTES)[self.starts - LENGTH_BYTES].view("<i4").reshape(-1, 4)
        views[:, 0] = self.lengths
        return views

    def _windows(self, num_bytes: int) -> np.ndarray:
        # `num_bytes` bytes from every offset of the text, without a copy.
        return np.ndarray((len(self.padded) - num_bytes,), dtype=f"V{num_bytes}", buffer=self.padded, strides=(1,))


def find_words(text: bytes) -> Words:
    """All words of a text."""
    padded = b"".join((b"\n" * LENGTH_BYTES, text, b"\n" * (VIEW_BYTES + 1)))
    characters = np.frombuffer(padded, np.uint8)
    solid = characters > SPACE
    edges = np.flatnonzero(solid[1:] != solid[:-1]) + 1
    starts, ends = edges[::2], edges[1::2]
    return Words(padded, starts, ends - starts, _opens_line(characters, starts, ends))


def _opens_line(
    characters: UInt8[np.ndarray, "bytes"], starts: Int64[np.ndarray, "words"], ends: Int64[np.ndarray, "words"]
) -> Bool[np.ndarray, "words"]:
    # The byte before a word decides, unless there are several between two words.
    opens: np.ndarray = characters[starts - 1] == NEWLINE
    gap_starts = np.concatenate(([0], ends[:-1]))[: len(starts)]
    unclear = np.flatnonzero(~opens & (starts - gap_starts > 1))
    if unclear.size:
        newlines = np.flatnonzero(characters == NEWLINE)
        before, after = (np.searchsorted(newlines, places[unclear]) for places in (gap_starts, starts))
        opens[unclear] = before < after
    return opens


def to_numbers(words: Words) -> Float64[np.ndarray, "words"] | None:
    """The words as numbers; None if one is not a finite number in the valid range."""
    import pyarrow as pa

    views = words.views()
    long = np.flatnonzero(words.lengths > INLINE_BYTES)
    if long.size:
        # Longer words are stored as four bytes, a buffer's number and an offset into it.
        views[long, 2], views[long, 3] = 0, words.starts[long]
    buffers = [None, pa.py_buffer(views), pa.py_buffer(words.padded)]
    try:
        column = pa.Array.from_buffers(pa.string_view(), len(views), buffers).cast(pa.float64())
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
        return None
    values = np.frombuffer(column.buffers()[1], np.float64, len(column))  # `to_numpy` would import pandas: 0.3 s
    return values if (np.abs(values) < LARGEST_VALUE).all() else None


def read_table(
    text: bytes, num_rows: int, num_columns: int, path: Path, first_line: int
) -> Float64[np.ndarray, "rows columns"]:
    """The numbers of a text with one line for each row; empty lines are skipped.

    `first_line` is the number of its first line in the file. Raises `FormatError` (`truncated`, `channel-count`,
    `frame-count`, `not-a-number`, `nan`, `range`) naming the line and the frame.
    """
    # A number takes at least a digit and a separator.
    most_rows = len(text) // (2 * num_columns) + 1
    table = np.empty((min(num_rows, most_rows), num_columns))
    row, line, num_read = 0, first_line, 0
    for block in blocks(text):
        if len(block) > LONGEST_LINE_BYTES:
            message = f"a line of more than {LONGEST_LINE_BYTES >> 20} MiB, expected lines of numbers"
            raise FormatError(message, path=path, reason="range", line=line)
        num_read += len(block)
        rows = _rows_of_block(block, num_columns)
        if rows is None or row + len(rows) > num_rows:
            rows = _rows_of_lines(block, num_columns, path, line, row, num_rows, is_last=num_read == len(text))
        table[row : row + len(rows)] = rows
        row += len(rows)
        line += block.count(b"\n")
    if row < num_rows:
        message = f"the file ends after {row} frames, expected {num_rows}"
        raise FormatError(message, path=path, reason="truncated", line=line, frame=row)
    return table


def format_table(table: Float64[np.ndarray, "rows columns"]) -> bytes:
    """One line per row, numbers separated by spaces, each with its shortest exact digits."""
    import pyarrow as pa
    from pyarrow import csv

    columns = pa.table({str(column): values for column, values in enumerate(np.ascontiguousarray(table.T))})
    buffer = pa.BufferOutputStream()
    csv.write_csv(columns, buffer, csv.WriteOptions(include_header=False, delimiter=" ", quoting_style="none"))
    return bytes(buffer.getvalue().to_pybytes())


def blocks(text: bytes) -> Iterator[bytes]:
    """The text in pieces of whole lines, each about `BLOCK_BYTES` long."""
    start = 0
    while start < len(text):
        stop = text.find(b"\n", start + BLOCK_BYTES) + 1 or len(text)
        yield text[start:stop]
        start = stop


def _rows_of_block(block: bytes, num_columns: int) -> Float64[np.ndarray, "rows columns"] | None:
    words = find_words(block)
    rows, rest = divmod(len(words.starts), num_columns)
    opens_row = np.zeros(num_columns, bool)
    opens_row[0] = True
    if rest or (words.opens_line.reshape(rows, num_columns) != opens_row).any():
        return None
    numbers = to_numbers(words)
    if numbers is None:
        return None
    return numbers.reshape(rows, num_columns)


def _rows_of_lines(
    block: bytes, num_columns: int, path: Path, first_line: int, first_row: int, num_rows: int, *, is_last: bool
) -> Float64[np.ndarray, "rows columns"]:
    """The rows of a block, line by line; raises what `read_table` raises. `is_last`: the text ends with the block."""
    numbers: list[list[float]] = []
    lines = block.rstrip().split(b"\n")
    last_line = first_line + len(lines) - 1
    for line_number, line in enumerate(lines, start=first_line):
        words = line.split()
        if not words:
            continue
        frame = first_row + len(numbers)
        if frame == num_rows:
            raise FormatError(
                f"a line of numbers after the {num_rows} declared frames; expected the end of the file",
                path=path,
                reason="frame-count",
                line=line_number,
            )
        if len(words) < num_columns and is_last and line_number == last_line:
            raise FormatError(
                f"the file ends after {len(words)} of {num_columns} numbers, expected {num_rows} whole frames",
                path=path,
                reason="truncated",
                line=line_number,
                frame=frame,
            )
        if len(words) != num_columns:
            raise FormatError(
                f"{len(words)} numbers, expected {num_columns} (one for each channel)",
                path=path,
                reason="channel-count",
                line=line_number,
                frame=frame,
            )
        numbers.append([parse_number(word, path, line_number, frame) for word in words])
    return np.array(numbers, dtype=np.float64).reshape(len(numbers), num_columns)


def parse_number(word: bytes | str, path: Path, line: int, frame: int | None = None) -> float:
    """A finite number in the valid range; raises `FormatError` (`not-a-number`, `nan`, `range`) naming the line."""
    shown = word.decode("utf-8", "backslashreplace") if isinstance(word, bytes) else word
    try:
        if "_" in shown:
            raise ValueError
        value = float(shown)
    except ValueError:
        raise FormatError(
            f"{shown[:40]!r} where a number was expected", path=path, reason="not-a-number", line=line, frame=frame
        ) from None
    if not np.isfinite(value):
        raise FormatError(
            f"{shown} where a finite number was expected", path=path, reason="nan", line=line, frame=frame
        )
    if abs(value) >= LARGEST_VALUE:
        raise FormatError(
            f"{value:g} is beyond ±{LARGEST_VALUE:g}; no channel of a body is",
            path=path,
            reason="range",
            line=line,
            frame=frame,
        )
    return value
