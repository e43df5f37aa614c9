"""The numbers of a BVH file, some thousand frames at a time, so that its text is never in memory as a whole."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float64

from motionkit.formats.bvh.text import BvhText
from motionkit.formats.source import number_table
from motionkit.formats.source.number_table import TablePart
from motionkit.formats.source.sizes import check_size
from motionkit.formats.source.source_file import FileParts

FRAMES_AT_ONCE = 4096


def read_tables(file: FileParts, head: BvhText) -> Iterator[Float64[np.ndarray, "some channels"]]:
    """All frames' numbers (file units, degrees) in order, in tables of at least 4,096 frames but for the last.

    Nothing is yielded of a file too small for the frames that it declares. Raises `FormatError`: `too-large` before the
    first table, for frames that are missing after the last, and else as `number_table.parse_table` does.
    """
    path, columns = file.path, head.hierarchy.num_channels
    end, line, found = file.end_of_text(), head.body_line, 0
    # A number takes at least a digit and a separator.
    believed = 2 * head.num_frames * columns - 1 <= end - head.body_start
    if believed:
        check_size(head.num_frames, len(head.hierarchy.joints), path)
    waiting: list[Float64[np.ndarray, "some channels"]] = []
    num_waiting = 0
    for place, block in file.line_blocks(head.body_start, end, number_table.BLOCK_BYTES):
        part = TablePart(line, found, head.num_frames, is_end=place + len(block) == end)
        table = number_table.find_rows(block, columns, path, part).table
        found += len(table)
        line += block.count(b"\n")
        if believed:
            waiting.append(table)
            num_waiting += len(table)
        if num_waiting >= FRAMES_AT_ONCE:
            yield np.concatenate(waiting)
            waiting, num_waiting = [], 0
    if found < head.num_frames:
        raise number_table.too_few_rows(found, head.num_frames, path, line)
    if waiting:
        yield np.concatenate(waiting)


def parts_of(num_frames: int) -> list[slice]:
    """The frames from first to last, so many at a time."""
    return [slice(start, start + FRAMES_AT_ONCE) for start in range(0, num_frames, FRAMES_AT_ONCE)]
