"""Columns of floats → Parquet data pages: compressed by whichever process has the frames, joined by the writer's.

Arrow writes pages only as part of a file, so that one process would have to compress everything. Here each byte plane
(BYTE_STREAM_SPLIT) of at most 16 segments of a sequence is compressed for itself, as a zstd frame, wherever it will
lie. A page is made of such frames: first that of its levels, then those of the lowest bytes of all its sequences, and
so on. Frames that follow each other are one stream (RFC 8878, section 3.1). Planes apart, a sequence needs no
neighbours to compress well; with high and low bytes under one table of codes it takes 5 % more.

Source of the format: https://parquet.apache.org/docs/file-format/data-pages/
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from zlib import crc32

import numpy as np
import pyarrow as pa
from jaxtyping import Float32, Int32, UInt8

from motionkit.store.schema import RUN_SEGMENTS, SEGMENT_FRAMES
from motionkit.store.thrift import i32, struct, varint

# Numbers of the format (parquet.thrift): PageType, Encoding.
DATA_PAGE = 0
PLAIN, RLE, BYTE_STREAM_SPLIT = 0, 3, 9

# Levels of zstd: the lower two byte planes of a number are noise, of which none finds much; the upper two repeat.
_LOW, _HIGH = (pa.Codec("zstd", compression_level=level) for level in (1, 4))
_CODECS = (_LOW, _LOW, _HIGH, _HIGH)


@dataclass(frozen=True, eq=False)
class Run:
    """At most 16 segments of one sequence that follow each other, in one column of floats, compressed; picklable.

    `frames` are those of the four byte planes, the lowest bytes first, and `frame_sizes` their bytes: none where the
    source has no such numbers, and each segment's list is null. `lengths` are the numbers of values of the lists.
    """

    frames: UInt8[np.ndarray, "bytes"]
    frame_sizes: tuple[int, ...]
    lengths: tuple[int, ...]

    @property
    def num_rows(self) -> int:
        """Number of segments."""
        return len(self.lengths)

    def copy(self) -> "Run":
        """The same in memory of its own."""
        return replace(self, frames=self.frames.copy())


@dataclass(frozen=True, eq=False)
class Page:
    """One data page as it stands in a file: header and body; `num_values` counts nulls too.

    `num_bytes_plain` is its size with its body uncompressed. The header holds the CRC-32 of the body.
    """

    header: bytes
    body: bytes
    num_values: int
    num_bytes_plain: int


def float_runs(values: Float32[np.ndarray, "values"] | None, num_frames: int) -> tuple[Run, ...]:
    """A column of one sequence, compressed; `values` hold its segments one after the other, None is null."""
    frames = segment_frames(num_frames)
    runs, start = [], 0
    for first in range(0, len(frames), RUN_SEGMENTS):
        of_run = frames[first : first + RUN_SEGMENTS]
        if values is None:
            runs.append(Run(np.empty(0, np.uint8), (), (0,) * len(of_run)))
            continue
        lengths = values.size // num_frames * of_run
        stop = start + int(lengths.sum())
        planes = np.ascontiguousarray(values[start:stop].view(np.uint8).reshape(-1, 4).T)
        compressed = [codec.compress(plane, asbytes=True) for codec, plane in zip(_CODECS, planes, strict=True)]
        content = np.frombuffer(b"".join(compressed), np.uint8)
        runs.append(Run(content, tuple(map(len, compressed)), tuple(lengths.tolist())))
        start = stop
    return tuple(runs)


def float_page(runs: Sequence[Run], *, nullable: bool) -> Page:
    """The page of a column of lists of floats; `nullable` says whether the column may hold nulls."""
    # Levels of definition: of an optional list it takes one to be there, of an element one more.
    defined = 2 if nullable else 1
    repetition, definition = [], []
    for run in runs:
        if run.frame_sizes:
            repetition += [level for length in run.lengths for level in ((0, 1), (1, length - 1))]
            definition.append((defined, sum(run.lengths)))
        else:
            repetition.append((0, run.num_rows))
            definition.append((0, run.num_rows))
    levels = _levels(repetition) + _levels(definition)
    planes = zip(*(_frames(run) for run in runs if run.frame_sizes), strict=True)
    pieces = (_LOW.compress(levels, asbytes=True), *(frame for plane in planes for frame in plane))
    num_values = sum(count for _, count in definition)
    return _page(pieces, num_values, len(levels) + 4 * sum(map(sum, (run.lengths for run in runs))), BYTE_STREAM_SPLIT)


def integer_page(values: Int32[np.ndarray, "values"]) -> Page:
    """The page of a column of integers without nulls."""
    return _page((_LOW.compress(values.astype("<i4"), asbytes=True),), values.size, values.nbytes, PLAIN)


def num_segments(num_frames: int) -> int:
    """Number of segments of ≤ 256 frames that hold `num_frames`."""
    return -(-num_frames // SEGMENT_FRAMES)


def segment_frames(num_frames: int) -> Int32[np.ndarray, "segments"]:
    """Number of frames of each segment: 256, and what remains."""
    starts = np.arange(0, num_frames, SEGMENT_FRAMES, dtype=np.int32)
    return np.minimum(SEGMENT_FRAMES, num_frames - starts, dtype=np.int32)


def _frames(run: Run) -> list[memoryview]:
    ends = accumulate(run.frame_sizes)
    return [run.frames[end - size : end].data for end, size in zip(ends, run.frame_sizes, strict=True)]


def _levels(runs: Iterable[tuple[int, int]]) -> bytes:
    """Runs of equal levels (level, count) in Parquet's RLE, behind the number of its bytes."""
    content = b"".join(varint(count << 1) + bytes([level]) for level, count in runs if count)
    return len(content).to_bytes(4, "little") + content


def _page(pieces: tuple[bytes | memoryview, ...], num_values: int, num_bytes: int, encoding: int) -> Page:
    body = b"".join(pieces)
    of_data = struct({1: i32(num_values), 2: i32(encoding), 3: i32(RLE), 4: i32(RLE)})
    checksum = int.from_bytes(crc32(body).to_bytes(4, "little"), "little", signed=True)
    fields = {1: i32(DATA_PAGE), 2: i32(num_bytes), 3: i32(len(body)), 4: i32(checksum), 5: of_data}
    header = struct(fields).content
    return Page(header, body, num_values, len(header) + num_bytes)
