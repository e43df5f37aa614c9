"""Annotation tables: captions, actions, splits, framerates, licences of motions whose files cannot hold them.

The first row of a CSV file names the columns: `file` (path from the CSV's folder) and any of `caption`, `caption_kit`
(a second caption), `captions` (any number, as JSON), `action`, `style`, `subject` (or `performer`), `split`, `fps`,
`stated_fps`, `licence`, `source`, `subset`, `skip_frames` (number of frames to drop at the start: a T-pose); for
generated motions also `group` (shared by those of one prompt) and `num_frames` (number of frames without padding).
Unknown columns are ignored with a warning.
"""

import csv
import io
import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from motionkit.core.errors import FormatError, shown, suggestion
from motionkit.core.files import parse_json, whole_number
from motionkit.core.motion import Caption
from motionkit.core.timegrid import parse_fps
from motionkit.io import source_file
from motionkit.io.registry import SourceItem

TEXT_COLUMNS = ("action", "style", "subject", "split", "stated_fps", "licence", "source", "subset", "group")
COLUMNS = frozenset(
    (*TEXT_COLUMNS, "caption", "caption_kit", "captions", "performer", "fps", "num_frames", "skip_frames")
)
# Columns that motionkit itself writes, for information and for its own checks.
OTHER_COLUMNS = frozenset(("file", "sequence_id", "seconds", "files_sha256", "checksum"))
CAPTION_KEYS = frozenset(("text", "start_seconds", "end_seconds", "tokens"))


# What a row states of its file: fields of `SourceItem`, `group`, `num_frames`, and `line`, the row's in the table.
Annotation = dict[str, Any]


@dataclass(frozen=True)
class AnnotationTable:
    """The rows of one CSV by absolute path of the file they describe, and the rows that could not be used.

    `warnings` name the ignored columns (`unknown-column`).
    """

    path: Path
    rows: Mapping[Path, Annotation]
    problems: tuple[FormatError, ...] = ()
    warnings: tuple[FormatError, ...] = ()


def tables_in(folder: Path, given: Path | None = None) -> tuple[list[AnnotationTable], list[FormatError]]:
    """The annotation tables of a folder's CSV files but the `given` one, and the errors of those that cannot be read.

    A table has a column `file` and at least one other known column; one with another encoding or separator cannot be
    read.
    """
    tables: list[AnnotationTable] = []
    problems: list[FormatError] = []
    for path in sorted(folder.glob("*.csv")):
        try:
            names = source_file.header_names(path)
            is_given = bool(names) and given is not None and path.samefile(given)
            if "file" in names and COLUMNS & set(names) and not is_given:
                tables.append(read_annotations(path))
        except FormatError as problem:
            problems.append(problem)
    return tables, problems


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
                    message = f"{shown(row['file'])} is described twice, first in line {rows[target]['line']}"
                    raise FormatError(message, path=path, reason="duplicate-annotation", line=reader.line_num)
                rows[target] = _annotation(row, path, reader.line_num)
            except FormatError as problem:
                # Tracebacks would keep every bad row's stack frames in memory.
                problem.__context__ = None
                problems.append(problem.with_traceback(None))
    except csv.Error as error:
        raise FormatError(f"not a CSV table ({error})", path=path, reason="annotations", line=reader.line_num) from None
    unknown = [name for name in reader.fieldnames or () if name not in COLUMNS | OTHER_COLUMNS]
    listed = ", ".join(f"{shown(name)}{suggestion(name, COLUMNS)}" for name in unknown)
    warning = FormatError(f"columns that are not read: {listed}", path=path, reason="unknown-column", line=1)
    return AnnotationTable(path, rows, tuple(problems), (warning,) if unknown else ())


def annotated(item: SourceItem, tables: Iterable[AnnotationTable]) -> SourceItem:
    """The item with what tables state of its file; a later table takes precedence, column by column."""
    stated: dict[str, Any] = {}
    for table in tables:
        row = table.rows.get(item.path, {})
        if "source" in row:
            stated["subset"] = ""  # the folder's name is not a subset of a source that the row gives
        stated |= row
    return replace(item, **{each.name: stated[each.name] for each in fields(item) if each.name in stated})


def _inside(name: str | None, folder: Path, path: Path, line: int) -> Path:
    # A path from a file's content must stay inside the folder; links in it are the user's own.
    relative = (name or "").replace("\\", "/")
    within = str(folder).rstrip("/")
    # Strings, since a table may have a hundred thousand rows and `Path` is ten times as slow.
    target = os.path.normpath(f"{within}/{relative}")
    if not name or "\0" in name or relative.startswith("/") or not f"{target}/".startswith(f"{within}/"):
        message = f"file {shown(name)} is empty or leaves the folder; expected a path inside it"
        raise FormatError(message, path=path, reason="path", line=line)
    return Path(target)


def _annotation(row: Mapping[str, str | None], path: Path, line: int) -> Annotation:
    cells = {name: cell for name in COLUMNS if (cell := (row.get(name) or "").strip())}

    def fault(name: str, expected: object, reason: str = "annotations") -> FormatError:
        return FormatError(f"{name} {shown(cells[name])}: {expected}", path=path, reason=reason, line=line)

    stated = Annotation(line=line)
    stated |= {name: cells[name] for name in TEXT_COLUMNS if name in cells}
    if "performer" in cells:
        stated.setdefault("subject", cells["performer"])
    if "fps" in cells:
        try:
            stated["fps"] = parse_fps(cells["fps"])
        except ValueError as error:
            raise fault("fps", error, "frame-time") from None
    numbers: dict[str, int | None] = {
        name: whole_number(cells[name]) for name in ("num_frames", "skip_frames") if name in cells
    }
    for name, number in numbers.items():
        if number is None or (name == "num_frames" and number == 0):
            raise fault(name, "expected a number of frames")
    stated |= numbers
    sentences = dict.fromkeys(cells[name] for name in ("caption", "caption_kit") if name in cells)
    try:
        more = [_caption(value) for value in parse_json(cells.get("captions", "[]"))]
    except (ValueError, TypeError) as error:
        expected = f"expected a JSON list of sentences or of objects with text, start_seconds, end_seconds ({error})"
        raise fault("captions", expected) from None
    if sentences or more:
        stated["captions"] = (*map(Caption, sentences), *more)
    return stated


def _caption(value: object) -> Caption:
    """A sentence, or an object with `text` and any of `start_seconds`, `end_seconds`, `tokens`."""
    if isinstance(value, str):
        return Caption(value)
    if not isinstance(value, dict) or not isinstance(value.get("text"), str) or not value.keys() <= CAPTION_KEYS:
        raise TypeError(f"not a caption: {value!r}"[:80])
    start = float(value.get("start_seconds", 0.0))
    end = None if value.get("end_seconds") is None else float(value["end_seconds"])
    if not (math.isfinite(start) and (end is None or math.isfinite(end))):
        raise ValueError(f"seconds {start} to {end}")
    return Caption(value["text"], start, end, str(value.get("tokens", "")))
