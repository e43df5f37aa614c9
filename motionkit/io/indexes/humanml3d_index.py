"""HumanML3D's index.csv: source_path, start_frame, end_frame, new_name; 14,616 rows.

`formats.scan.cuts` explains how frames are counted. Rows of humanact12 have the end −1 and take the whole file. Source:
https://github.com/EricGuo5513/HumanML3D (index.csv, raw_pose_processing.ipynb).
"""

import csv
import re
from collections.abc import Mapping
from pathlib import Path

from motionkit.core.errors import FormatError
from motionkit.io.indexes.entries import (
    Dataset,
    Entry,
    Index,
    dataset_of,
    read_entries,
    sequence_name,
    source_parts,
)
from motionkit.io.scan.cuts import StepCut
from motionkit.io.source import source_file

NAME = "humanml3d"
COLUMNS = ("source_path", "start_frame", "end_frame", "new_name")
HUMANACT12 = "humanact12"
WHOLE_FILE = -1
# Cells beyond the last column.
EXTRA = "\0"
# A day at 20 fps: no capture has more frames.
MAX_FRAME = 24 * 3600 * 20


def recognise(head: str) -> bool:
    """Whether the beginning of a file is an index of this kind: its header names the first and the last column."""
    line = head.lstrip().partition("\n")[0]
    return "source_path" in line and "new_name" in line


def read_humanml3d_index(path: Path) -> Index:
    """Read an index; a bad row becomes one of its problems, with its line.

    Raises `FormatError` (`index`, `encoding`, `empty`) for any other file.
    """
    text = source_file.decode(source_file.read_bytes(path), path)
    reader = csv.DictReader(text.splitlines(keepends=True), restkey=EXTRA, strict=True)
    try:
        columns = [name.strip() for name in reader.fieldnames or ()]
        absent = [name for name in COLUMNS if name not in columns]
        if absent:
            raise FormatError(
                f"no column {', '.join(absent)}; expected {','.join(COLUMNS)}, separated by commas",
                path=path,
                reason="index",
                line=1,
            )
        reader.fieldnames = columns
        return read_entries(
            NAME, path, reader, lambda row: _entry(row, path, reader.line_num), in_published_frames=True
        )
    except csv.Error as error:
        raise FormatError(f"not a CSV table ({error})", path=path, reason="index", line=reader.line_num) from None


def _entry(row: Mapping[str, str | None], path: Path, line: int) -> Entry:
    place = f"line {line}"
    if row.get(EXTRA):
        raise FormatError(
            "more cells than columns; a path with a comma needs quotes", path=path, reason="index-entry", line=line
        )
    parts = source_parts(row["source_path"], path, "source_path", line)
    name = sequence_name((row["new_name"] or "").strip().removesuffix(".npy"), path, "new_name", line)
    start, end = (_frame(row, column, path, line) for column in ("start_frame", "end_frame"))
    found = dataset_of(parts)
    dataset = found[0] if found else Dataset("")
    whole = dataset.name == HUMANACT12 and (start, end) == (0, WHOLE_FILE)
    if not whole and not 0 <= start < end:
        raise FormatError(
            f"frames [{start}, {end}); expected 0 <= start_frame < end_frame (0 and -1 for {HUMANACT12})",
            path=path,
            reason="index-entry",
            line=line,
        )
    cut = StepCut(start, None if whole else end, dataset.trim_frames, dataset.seen_fps_of(parts))
    return Entry(name, parts, place, line, cut)


def _frame(row: Mapping[str, str | None], column: str, path: Path, line: int) -> int:
    cell = (row[column] or "").strip()
    # Pandas writes integers as floats if another row of the column is empty.
    if re.fullmatch(r"-?\d{1,8}(\.0)?", cell, re.ASCII) and -1 <= int(float(cell)) <= MAX_FRAME:
        return int(float(cell))
    raise FormatError(
        f"{column} is {cell[:40]!r}, expected a whole number of frames", path=path, reason="index-entry", line=line
    )
