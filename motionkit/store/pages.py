"""Columns of one sequence → Parquet data pages: made by whichever process has the frames, joined by the writer's.

Arrow writes pages only as part of a file, so that one process would have to compress everything. Here a page holds at
most 16 segments of one sequence, and nothing in it depends on where it will lie. Byte planes (BYTE_STREAM_SPLIT) are
compressed each for itself, as zstd frames that follow each other (RFC 8878, section 3.1): a page of one sequence is so
short that zstd would otherwise code high and low bytes of its numbers by one table, which costs 5 % of size.

Source of the format: https://parquet.apache.org/docs/file-format/data-pages/
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pyarrow as pa
from jaxtyping import Float32, Int32, UInt8

from motionkit.store.schema import PAGE_SEGMENTS, SEGMENT_FRAMES
from motionkit.store.thrift import i32, struct, varint

# Numbers of the format (parquet.thrift): PageType, Encoding.
DATA_PAGE = 0
PLAIN, RLE, BYTE_STREAM_SPLIT = 0, 3, 9

# Levels of zstd: the lower two byte planes of a number are noise, of which none finds much; the upper two repeat.
_LOW, _HIGH = (pa.Codec("zstd", compression_level=level) for level in (1, 4))
_CODECS = (_LOW, _LOW, _HIGH, _HIGH)


@dataclass(frozen=True, eq=False)
class Page:
    """One data page as it stands in a file, header and compressed body; picklable.

    `num_rows` are segments; `num_values` counts the elements of their lists, and lists that are null;
    `num_bytes_plain` is the page's size with its body uncompressed.
    """

    content: UInt8[np.ndarray, "bytes"]
    num_rows: int
    num_values: int
    num_bytes_plain: int

    def copy(self) -> "Page":
        """The same page in memory of its own."""
        return replace(self, content=self.content.copy())


def float_pages(values: Float32[np.ndarray, "values"] | None, num_frames: int, *, nullable: bool) -> tuple[Page, ...]:
    """Pages of a column of lists, one list for each segment of a sequence; without values each list is null.

    `values` hold its segments one after the other. `nullable` says whether the column may hold nulls.
    """
    # Levels of definition: of an optional list it takes one to be there, of an element one more.
    defined = 2 if nullable else 1
    frames = segment_frames(num_frames)
    pages, start = [], 0
    for first in range(0, len(frames), PAGE_SEGMENTS):
        of_page = frames[first : first + PAGE_SEGMENTS]
        if values is None:
            pages.append(_page(_null_levels(len(of_page)), len(of_page)))
            continue
        lengths = values.size // num_frames * of_page
        stop = start + int(lengths.sum())
        pages.append(_page(_list_levels(lengths.tolist(), defined), len(of_page), values[start:stop]))
        start = stop
    return tuple(pages)


def integer_page(values: Int32[np.ndarray, "values"]) -> Page:
    """The page of a column of integers without nulls."""
    content = _LOW.compress(values.astype("<i4"), asbytes=True)
    return _with_header([content], values.size, values.size, values.nbytes, PLAIN)


def num_segments(num_frames: int) -> int:
    """Number of segments of ≤ 256 frames that hold `num_frames`."""
    return -(-num_frames // SEGMENT_FRAMES)


def segment_frames(num_frames: int) -> Int32[np.ndarray, "segments"]:
    """Number of frames of each segment: 256, and what remains."""
    starts = np.arange(0, num_frames, SEGMENT_FRAMES, dtype=np.int32)
    return np.minimum(SEGMENT_FRAMES, num_frames - starts, dtype=np.int32)


def _list_levels(lengths: Sequence[int], defined: int) -> bytes:
    repetition = [run for length in lengths for run in ((0, 1), (1, length - 1))]
    return _levels(repetition) + _levels([(defined, sum(lengths))])


def _null_levels(count: int) -> bytes:
    return _levels([(0, count)]) + _levels([(0, count)])


def _levels(runs: Iterable[tuple[int, int]]) -> bytes:
    """Runs of equal levels (level, count) in Parquet's RLE, behind the number of its bytes."""
    content = b"".join(varint(count << 1) + bytes([level]) for level, count in runs if count)
    return len(content).to_bytes(4, "little") + content


def _page(levels: bytes, num_rows: int, values: Float32[np.ndarray, "values"] | None = None) -> Page:
    """Levels, then the byte planes of the values; without values each row is null."""
    size = 0 if values is None else values.size
    body = np.empty(len(levels) + 4 * size, np.uint8)
    body[: len(levels)] = np.frombuffer(levels, np.uint8)
    if values is not None:
        body[len(levels) :].reshape(4, -1)[...] = values.view(np.uint8).reshape(-1, 4).T
    # The first frame holds the levels as well, and alone where there is nothing else.
    bounds = [0, *range(len(levels) + size, len(body) + 1, size or 1)]
    planes = zip(_CODECS, pairwise(bounds), strict=False)
    frames = [codec.compress(body[start:stop], asbytes=True) for codec, (start, stop) in planes]
    return _with_header(frames, num_rows, size or num_rows, len(body), BYTE_STREAM_SPLIT)


def _with_header(frames: Sequence[bytes], num_rows: int, num_values: int, num_bytes: int, encoding: int) -> Page:
    of_data = struct({1: i32(num_values), 2: i32(encoding), 3: i32(RLE), 4: i32(RLE)})
    compressed = sum(map(len, frames))
    header = struct({1: i32(DATA_PAGE), 2: i32(num_bytes), 3: i32(compressed), 5: of_data}).content
    content = np.frombuffer(b"".join((header, *frames)), np.uint8)
    return Page(content, num_rows, num_values, len(header) + num_bytes)
