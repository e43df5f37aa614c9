"""Sidecar CSV files: captions, actions, splits, framerates, licences of motions whose files cannot hold them.

The first row names the columns: `file` (path from the CSV's folder) and any of `caption`, `caption_kit` (a second
caption), `captions` (any number, as JSON), `action`, `style`, `subject` (or `performer`), `split`, `fps`, `stated_fps`,
`licence`, `source`, `subset`, `skip_frames` (number of frames to drop at the start: a T-pose); for generated motions
also `group` (shared by those of one prompt) and `num_frames` (number of frames without padding). Unknown columns are
ignored with a warning.
"""

import csv
import io
import math
import os
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

from motionkit.core.errors import FormatError
from motionkit.core.framerate import parse_fps
from motionkit.core.motion import Caption
from motionkit.core.plain_text import parse_json, shown, suggestion, whole_number
from motionkit.io.source import source_file
from motionkit.io.texts import SPLITS

COLUMNS = frozenset(
    (
        *("caption", "caption_kit", "captions", "action", "style", "subject", "performer", "split"),
        *("fps", "stated_fps", "licence", "source", "subset", "group", "num_frames", "skip_frames"),
    )
)
# Columns that motionkit itself writes, for information and for its own checks.
OTHER_COLUMNS = frozenset(("file", "sequence_id", "seconds", "files_sha256", "checksum"))
# Other tools' names of the column `file`.
NAMES_OF_FILE = frozenset(("filename", "file_name", "filepath", "file_path", "path"))
SHOWN = 5
# In bytes, on Linux.
LONGEST_NAME, LONGEST_PATH = 255, 4096
CAPTION_COLUMNS = ("caption", "caption_kit")
CAPTION_KEYS = frozenset(("text", "start_seconds", "end_seconds", "tokens"))
MAX_LICENCE_LINE = 120


@dataclass(frozen=True)
class Annotation:
    """A row's annotations of one file; fields are empty if the row gives none."""

    captions: tuple[Caption, ...] = ()
    action: str = ""
    style: str = ""
    subject: str = ""
    split: str = ""
    fps: Fraction | None = None
    stated_fps: str = ""
    licence: str = ""
    source: str = ""
    subset: str = ""
    group: str = ""
    num_frames: int | None = None
    skip_frames: int | None = None
    line: int = 0


@dataclass(frozen=True)
class AnnotationTable:
    """The rows of one CSV by absolute path of the file they describe, and the rows that could not be used.

    `warnings` name the ignored columns (`unknown-column`) and splits unknown to any command (`unknown-split`).
    """

    path: Path
    rows: Mapping[Path, Annotation]
    has_captions: bool
    problems: tuple[FormatError, ...] = field(default=())
    warnings: tuple[FormatError, ...] = field(default=())


def tables_in(folder: Path, given: Path | None = None) -> tuple[list[AnnotationTable], list[FormatError]]:
    """The annotation tables of a folder's CSV files but the `given` one, and the errors of those that cannot be read.

    A table has a column `file` and at least one other known column; one with another encoding or separator cannot be
    read. If a column's name is only similar to a known one, the table has no rows and a warning.
    """
    tables: list[AnnotationTable] = []
    problems: list[FormatError] = []
    for path in sorted(folder.glob("*.csv")):
        try:
            names = source_file.header_names(path)
        except FormatError as problem:
            problems.append(problem)
            continue
        if names and given is not None and path.samefile(given):
            continue
        if "file" not in names:
            tables += _nearly_tables(names, path)
            continue
        if COLUMNS & set(names):
            try:
                tables.append(read_annotations(path))
            except FormatError as problem:
                problems.append(problem)
        elif any(suggestion(name, COLUMNS) for name in names if name not in OTHER_COLUMNS):
            tables.append(AnnotationTable(path, {}, False, warnings=tuple(_unknown_columns(names, path))))
    return tables, problems


def _nearly_tables(names: Collection[str], path: Path) -> Iterator[AnnotationTable]:
    """A table without rows, with a warning that a column which seems to hold files must be called `file`."""
    for name in NAMES_OF_FILE.intersection(names):
        message = f"the table is not read: it has a column {shown(name)}, which has to be called 'file'"
        warning = FormatError(message, path=path, reason="unknown-column", line=1)
        yield AnnotationTable(path, {}, False, warnings=(warning,))


def read_annotations(path: Path, folder: Path | None = None) -> AnnotationTable:
    """Read a CSV; paths in it are relative to `folder` (its own by default) and may not leave it.

    Raises `FormatError` for any other file; invalid rows become the table's `problems`.
    """
    folder = Path(os.path.normpath((folder or path.parent).absolute()))  # links kept, as in the paths of a scan
    text = source_file.decode(source_file.read_bytes(path), path)
    reader = csv.DictReader(io.StringIO(text, newline=""), restkey="", strict=True)
    rows: dict[Path, Annotation] = {}
    problems: list[FormatError] = []
    try:
        if "file" not in (reader.fieldnames or ()):
            message = "no column 'file', expected a header with it, columns separated by commas"
            raise FormatError(message, path=path, reason="annotations", line=1)
        for row in reader:
            try:
                target = _inside(row["file"], folder, path, reader.line_num)
                if target in rows:
                    raise FormatError(
                        f"{shown(row['file'])} is described twice, first in line {rows[target].line}",
                        path=path,
                        reason="duplicate-annotation",
                        line=reader.line_num,
                    )
                rows[target] = _annotation(row, path, reader.line_num)
            except FormatError as problem:
                # Tracebacks would keep every bad row's stack frames in memory.
                problem.__context__ = None
                problems.append(problem.with_traceback(None))
    except csv.Error as error:
        raise FormatError(f"not a CSV table ({error})", path=path, reason="annotations", line=reader.line_num) from None
    has_captions = any(row.captions for row in rows.values())
    warnings = (*_unknown_columns(reader.fieldnames or (), path), *_unknown_splits(rows.values(), path))
    return AnnotationTable(path, rows, has_captions, tuple(problems), warnings)


def _unknown_columns(names: Sequence[str], path: Path) -> Iterator[FormatError]:
    unknown = [name for name in names if name not in COLUMNS | OTHER_COLUMNS]
    if unknown:
        listed = ", ".join(f"{shown(name)}{suggestion(name, COLUMNS)}" for name in unknown[:SHOWN])
        more = f" and {len(unknown) - SHOWN:,} more" if len(unknown) > SHOWN else ""
        message = f"{'columns that are' if len(unknown) > 1 else 'a column that is'} not read: {listed}{more}"
        yield FormatError(message, path=path, reason="unknown-column", line=1)


def _unknown_splits(rows: Collection[Annotation], path: Path) -> Iterator[FormatError]:
    unknown = Counter(row.split for row in rows if row.split and row.split not in SPLITS)
    if unknown:
        listed = ", ".join(
            f"{shown(split)}{suggestion(split, SPLITS)} in {count:,} row{'s'[: count > 1]}"
            for split, count in unknown.most_common(SHOWN)
        )
        more = f" and {len(unknown) - SHOWN:,} more" if len(unknown) > SHOWN else ""
        message = f"split {listed}{more}; commands know {', '.join(SPLITS)}"
        line = next(row.line for row in rows if row.split in unknown)
        yield FormatError(message, path=path, reason="unknown-split", line=line)


def licence_files(folder: Path) -> list[Path]:
    """The licence files of a folder, by their names."""
    return sorted(entry for entry in folder.iterdir() if entry.name.upper().startswith(("LICENSE", "LICENCE")))


def find_licence(folder: Path) -> str:
    """First line of the folder's licence file (the files' names if there are several); empty if there is none."""
    files = licence_files(folder)
    lines = list(dict.fromkeys(line for entry in files if entry.is_file() for line in _first_line(entry)))
    if len(lines) == 1:
        return lines[0]
    return ", ".join(entry.name for entry in files)


def _first_line(path: Path) -> Iterator[str]:
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            head = file.read(4096)
    except OSError:
        return
    for line in head.splitlines():
        if line.strip():
            yield " ".join(line.split())[:MAX_LICENCE_LINE]
            return


def _inside(name: str | None, folder: Path, path: Path, line: int) -> Path:
    # A path from a file's content must stay inside the folder; links in it are the user's own.
    relative = (name or "").replace("\\", "/")
    within = str(folder).rstrip("/")
    # Strings, since a table may have a hundred thousand rows and `Path` is ten times as slow.
    target = os.path.normpath(f"{within}/{relative}")
    if not name or "\0" in name or relative.startswith("/") or not f"{target}/".startswith(f"{within}/"):
        raise FormatError(
            f"file {shown(name)} is empty or leaves the folder; expected a path inside it",
            path=path,
            reason="path",
            line=line,
        )
    if len(target.encode()) >= LONGEST_PATH or max(len(part.encode()) for part in relative.split("/")) > LONGEST_NAME:
        message = f"file {shown(name)} is longer than a file's name can be"
        raise FormatError(message, path=path, reason="path", line=line)
    return Path(target)


def _annotation(row: Mapping[str, str | None], path: Path, line: int) -> Annotation:
    cell = {name: (row.get(name) or "").strip() for name in COLUMNS}
    try:
        fps = parse_fps(cell["fps"]) if cell["fps"] else None
    except ValueError as error:
        raise FormatError(f"fps {shown(cell['fps'])}: {error}", path=path, reason="frame-time", line=line) from None
    num_frames = whole_number(cell["num_frames"]) if cell["num_frames"] else None
    if cell["num_frames"] and not num_frames:
        raise FormatError(
            f"num_frames {shown(cell['num_frames'])}, expected how many frames are motion",
            path=path,
            reason="annotations",
            line=line,
        )
    skip_frames = whole_number(cell["skip_frames"])
    if skip_frames is None and cell["skip_frames"]:
        message = f"skip_frames {shown(cell['skip_frames'])}, expected how many frames to leave out at the start"
        raise FormatError(message, path=path, reason="annotations", line=line)
    sentences = dict.fromkeys(cell[name] for name in CAPTION_COLUMNS if cell[name])
    captions = (*(Caption(text) for text in sentences), *_captions(cell["captions"], path, line))
    cell["subject"] = cell["subject"] or cell["performer"]
    names = ("action", "style", "subject", "split", "stated_fps", "licence", "source", "subset", "group")
    return Annotation(
        captions=captions,
        fps=fps,
        num_frames=num_frames,
        skip_frames=skip_frames,
        line=line,
        **{name: cell[name] for name in names},
    )


def _captions(cell: str, path: Path, line: int) -> tuple[Caption, ...]:
    """A JSON list of sentences, or of objects with `text` and any of `start_seconds`, `end_seconds`, `tokens`."""
    try:
        return tuple(_caption(value) for value in parse_json(cell)) if cell else ()
    except (ValueError, TypeError) as error:
        raise FormatError(
            f"captions {cell[:40]!r}: expected a JSON list of sentences or of objects with text, start_seconds, "
            f"end_seconds ({error})",
            path=path,
            reason="annotations",
            line=line,
        ) from None


def _caption(value: object) -> Caption:
    if isinstance(value, str):
        return Caption(value)
    if not isinstance(value, dict) or not isinstance(value.get("text"), str) or not value.keys() <= CAPTION_KEYS:
        raise TypeError(f"not a caption: {value!r}"[:80])
    start = float(value.get("start_seconds", 0.0))
    end = None if value.get("end_seconds") is None else float(value["end_seconds"])
    if not (math.isfinite(start) and (end is None or math.isfinite(end))):
        raise ValueError(f"seconds {start} to {end}")
    return Caption(value["text"], start, end, str(value.get("tokens", "")))
