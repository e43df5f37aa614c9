"""The folder of a `motionkit generate` call: generation.json holds the request, motions.csv lists the results.

generation.json is written first and never changes; motions.csv gains a line when a motion's files are complete. So a
stopped call can be resumed, and `motionkit ingest` reads the folder with its captions. Both have checksums, also of the
motions' files, which are verified when the folder is read.
"""

import csv
import io
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, TextIO

from motionkit.core.checksums import checksum_of, read_json, sha256_of, write_json
from motionkit.core.errors import DamagedFileError, UsageError
from motionkit.core.files import LOCK, locked_folder, naming, read_regular, temporary_name, write_whole
from motionkit.core.framerate import format_fps
from motionkit.core.plain_text import whole_number
from motionkit.core.progress import warn
from motionkit.edit.export.files import TABLE, captions_json
from motionkit.generate.files import OutputFormat, output_formats
from motionkit.generate.models import GenerationRequest
from motionkit.generate.samples import GeneratedSample, motion_name

# As motionkit.io.scan.annotations reads them; seconds and num_frames are informative.
COLUMNS = ("file", "captions", "action", "fps", "seconds", "num_frames")
HINT = "delete it, and motionkit generate --resume makes all motions again"
FILES_CHECKSUM, ROW_CHECKSUM = "files_sha256", "checksum"
Row = dict[str, str]
MANIFEST = "generation.json"
FORMAT = "motionkit-generation"
# Whether motions.csv has checksums, which folders of older versions lack.
TABLE_CHECKSUMS = "table_checksums"
# Settings that may differ between a call and the one that it resumes.
MAY_DIFFER = ("versions", TABLE_CHECKSUMS)
# Settings that older versions did not write, and how to continue with their folders.
PLANTED, JOINS, CONSTRAINTS = "planted", "joins", "constraints"
OF_OLDER_VERSIONS = {
    PLANTED: "an older version made it, which planted nothing: --no-plant goes on with it",
    JOINS: "an older version made it, which joined motions otherwise: --overwrite makes all again",
}
ANOTHER = "name another folder with --out"


@dataclass(frozen=True)
class GeneratedTable:
    """The table of a folder, for its format; `has_checksums` is false in folders of older versions."""

    folder: Path
    output: OutputFormat
    has_checksums: bool = True

    @property
    def path(self) -> Path:
        """The file."""
        return self.folder / TABLE

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns."""
        return (*COLUMNS, FILES_CHECKSUM, ROW_CHECKSUM) if self.has_checksums else COLUMNS

    def row(self, sample: GeneratedSample) -> Row:
        """The row of a motion whose files are complete."""
        row = {
            "file": self.output.files(sample.name)[0].as_posix(),
            "captions": captions_json(sample.captions),
            "action": sample.action,
            "fps": "" if sample.fps is None else format_fps(sample.fps),
            "seconds": repr(sample.duration_seconds),
            "num_frames": str(len(sample.seconds)),
        }
        if self.has_checksums:
            row[FILES_CHECKSUM] = self._files_checksum(row)
            row[ROW_CHECKSUM] = checksum_of(row)
        return row

    def rows(self) -> list[Row]:
        """All rows, without an incomplete last line. Raises `DamagedFileError` for a damaged one."""
        columns, rows = self._read()
        if columns and tuple(columns) != self.columns:
            raise DamagedFileError(self.path, "its first line is not what was written", HINT)
        for number, row in enumerate(rows, start=1):
            whole = tuple(row) == self.columns and _names_a_file(row)
            if self.has_checksums and whole:
                content = {name: cell for name, cell in row.items() if name != ROW_CHECKSUM}
                whole = row[ROW_CHECKSUM] == checksum_of(content)
            if not whole:
                raise DamagedFileError(
                    self.path,
                    f"row {number} is not what was written",
                    "delete it and those after it, and motionkit generate --resume makes their motions again",
                )
        return rows

    def _read(self) -> tuple[Sequence[str], list[Row]]:
        """The names of the columns and all rows, unchecked."""
        if not self.path.is_file():
            return (), []
        data = read_regular(self.path)
        text = data[: data.rfind(b"\n") + 1].decode("utf-8", errors="replace")
        # For rows of the wrong length, csv gives None as a name or a cell.
        rows = csv.DictReader(io.StringIO(text, newline=""))
        try:
            found = [{str(name): str(cell) for name, cell in row.items()} for row in rows]
        except csv.Error as error:
            raise DamagedFileError(self.path, str(error), HINT) from None
        return rows.fieldnames or (), found

    def motion_names(self) -> list[str]:
        """The names of the motions in the table, unchecked; empty if it is not a table."""
        try:
            rows = self._read()[1]
        except DamagedFileError:
            return []
        return [PurePosixPath(row["file"]).stem for row in rows if _names_a_file(row)]

    def paths(self, row: Row) -> tuple[Path, ...]:
        """The files of a row's motion, by name alone, so that none is outside the folder."""
        return tuple(self.folder / place for place in self.output.files(PurePosixPath(row["file"]).stem))

    def fault(self, row: Row) -> str | None:
        """What is wrong with the files of a motion; None if they are intact, or unknown."""
        if not self.has_checksums or self._files_checksum(row) == row[FILES_CHECKSUM]:
            return None
        return "its content does not match its checksum"

    def keep(self, rows: Sequence[Row]) -> None:
        """Truncate the table to its first rows."""
        text = io.StringIO(newline="")
        writer = csv.DictWriter(text, self.columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        if self.path.is_file() and self.path.read_bytes() != text.getvalue().encode():
            write_whole(self.path, text.getvalue())

    def _files_checksum(self, row: Row) -> str:
        shared = [self.folder / name for name in self.output.shared]
        found = {path.relative_to(self.folder).as_posix(): _digest(path) for path in (*self.paths(row), *shared)}
        return checksum_of(found)


def _names_a_file(row: Row) -> bool:
    return bool(row.get("file")) and "\0" not in row["file"]


def _digest(path: Path) -> str:
    return sha256_of(path) if path.is_file() else "absent"


class GeneratedFolder:
    """Appends to motions.csv; `num_done` motions were complete when it was opened. Owns the open file."""

    def __init__(self, table: GeneratedTable, num_done: int) -> None:
        self.path, self.num_done, self._rows = table.folder, num_done, table
        self._handle: TextIO = table.path.open("a", encoding="utf-8", newline="")
        self._table = csv.DictWriter(self._handle, table.columns, lineterminator="\n")
        if not self._handle.tell():
            self._table.writeheader()

    def __enter__(self) -> "GeneratedFolder":
        return self

    def __exit__(self, *raised: object) -> None:
        with naming(self._rows.path):
            self._handle.close()

    def add(self, sample: GeneratedSample) -> None:
        """Record that a motion's files are complete."""
        with naming(self._rows.path):
            self._table.writerow(self._rows.row(sample))
            self._handle.flush()


@contextmanager
def open_folder(
    path: Path, manifest: Mapping[str, Any], *, resume: bool = False, overwrite: bool = False
) -> Iterator[GeneratedFolder]:
    """The folder of a call, locked while it is open: new or empty, or one to `resume` or `overwrite`.

    Overwriting deletes the files of an earlier call and nothing else. Raises `BusyError` while another process writes
    the folder, `UsageError` for one that is not empty or that another call made, `DamagedFileError`.
    """
    if path.exists() and not path.is_dir():
        raise UsageError(f"{path} is a file: name a folder with --out")
    opened = _resumed if resume else _replaced if overwrite else _new
    busy = f"another process is generating into {path}: wait until it has ended, or {ANOTHER}"
    with locked_folder(path, busy=busy), opened(path, manifest) as folder:
        yield folder


def _new(path: Path, manifest: Mapping[str, Any]) -> GeneratedFolder:
    left = [entry for entry in path.iterdir() if _is_unfinished_manifest(entry)]
    if any(entry not in left and entry.name != LOCK for entry in path.iterdir()):
        if (path / MANIFEST).is_file():
            raise UsageError(
                f"{path} holds generated motions: --resume continues them, --overwrite replaces them, --out FOLDER "
                "keeps both"
            )
        raise UsageError(f"{path} is not empty: {ANOTHER}")
    for entry in left:
        entry.unlink()
    return _begun(path, manifest)


def _resumed(path: Path, manifest: Mapping[str, Any]) -> GeneratedFolder:
    if not (path / MANIFEST).is_file():
        return _new(path, manifest)
    _refuse_links(path)
    found, asked = _read_manifest(path), json.loads(json.dumps(dict(manifest)))
    found = {**_of_older_versions(found), **found}
    differing = [name for name in {**asked, **found} if name not in MAY_DIFFER and found.get(name) != asked.get(name)]
    if differing:
        name = differing[0]
        if name in OF_OLDER_VERSIONS and name not in _read_manifest(path):
            raise UsageError(f"{path} cannot be resumed by this call: {OF_OLDER_VERSIONS[name]}")
        raise UsageError(
            f"{path} was begun with another {name} ({_short(found.get(name))}, now {_short(asked.get(name))}): repeat "
            "the same call, or name another folder with --out"
        )
    table = _table(path, found)
    return GeneratedFolder(table, _keep_complete(table))


def _replaced(path: Path, manifest: Mapping[str, Any]) -> GeneratedFolder:
    if not (path / MANIFEST).is_file():
        return _new(path, manifest)
    _refuse_links(path)
    found = _read_manifest(path)
    former = _table(path, found)
    names = {*_unnoted(former, found), *former.motion_names()}
    places = [*former.output.shared, *(str(place) for name in names for place in former.output.files(name))]
    for place in places:
        (path / place).unlink(missing_ok=True)
        temporary_name(path / place).unlink(missing_ok=True)
    former.path.unlink(missing_ok=True)
    return _begun(path, manifest)


@dataclass(frozen=True)
class DamagedMotion:
    """A motion with damaged files, the main one first."""

    paths: tuple[Path, ...]
    fault: str


def damaged_motions(path: Path) -> Iterator[DamagedMotion]:
    """The damaged motions of a folder of `motionkit generate`; other folders are not checked.

    Raises `DamagedFileError` for a damaged generation.json or motions.csv.
    """
    if not (path / MANIFEST).is_file():
        return
    try:
        found = _read_manifest(path)
    except UsageError:  # another program's file of that name
        return
    table = _table(path, found)
    for row in table.rows():
        fault = table.fault(row)
        if fault is not None:
            yield DamagedMotion(table.paths(row), fault)


def _begun(path: Path, manifest: Mapping[str, Any]) -> GeneratedFolder:
    written = {**manifest, TABLE_CHECKSUMS: True}
    write_json(path / MANIFEST, written)
    return GeneratedFolder(_table(path, written), 0)


def _table(path: Path, manifest: Mapping[str, Any]) -> GeneratedTable:
    return GeneratedTable(
        path, output_formats()[str(manifest["file_format"])], bool(manifest.get(TABLE_CHECKSUMS, False))
    )


def _keep_complete(table: GeneratedTable) -> int:
    """Truncate the table at the first incomplete motion; returns the number of complete ones."""
    done = []
    for row in table.rows():
        if not all(path.is_file() for path in table.paths(row)):
            warn(f"{row['file']} is missing: motions are generated again from there")
            break
        fault = table.fault(row)
        if fault is not None:
            hint = "delete it, and --resume makes it again; or --overwrite all"
            raise DamagedFileError(table.folder / row["file"], fault, hint)
        done.append(row)
    table.keep(done)
    return len(done)


def _unnoted(table: GeneratedTable, manifest: Mapping[str, Any]) -> Iterator[str]:
    """The names of a call's motions in the folder, whether the table has them or not."""
    try:
        requests = [
            GenerationRequest(each["seconds"], text=each["text"], action=each["action"])
            for each in manifest["conditions"]
        ]
        scripts = [tuple(requests)] if manifest["joined"] else [(request,) for request in requests]
        count = int(manifest["count"])
        for folder in {table.folder / place.parent for place in table.output.files("any")}:
            for path in folder.iterdir() if folder.is_dir() else ():
                name = path.name.lstrip(".").partition(".")[0]  # without the suffix and the marks of a temporary name
                number = whole_number(name.partition("-")[0])
                if number is None or number >= len(scripts) * count:
                    continue
                if name == motion_name(number, scripts[number // count]):
                    yield name
    except (KeyError, TypeError, ValueError):
        return


def _read_manifest(path: Path) -> dict[str, Any]:
    value = read_json(path / MANIFEST, f"delete the folder, or {ANOTHER}")
    if value.get("format") != FORMAT or str(value.get("file_format")) not in output_formats():
        raise UsageError(f"{path / MANIFEST} was not written by `motionkit generate`: {ANOTHER}")
    return value


def _refuse_links(path: Path) -> None:
    """Raise `UsageError` for a link below the folder, since its target may belong to others."""
    for folder, folders, files in os.walk(path):
        entries = (Path(folder, name) for name in (*folders, *files))
        link = next((entry for entry in entries if entry.is_symlink()), None)
        if link is not None:
            raise UsageError(f"{link} is a link: nothing is written or deleted through it; name another folder")


def _is_unfinished_manifest(path: Path) -> bool:
    """Whether this is a temporary generation.json of a killed call (with its process id in the name)."""
    name = path.name
    return name == temporary_name(path.with_name(MANIFEST)).name or (
        name.startswith(f".{MANIFEST}.") and name.endswith(".tmp")
    )


def _of_older_versions(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Settings of calls whose generation.json lacks them."""
    joins = None if manifest.get("overlap_seconds") is None else "cross-faded"
    return {PLANTED: False, "with_detail": False, JOINS: joins, CONSTRAINTS: []}


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else f"{text[:57]}…"
