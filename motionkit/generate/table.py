"""motions.csv of a generated folder: a row for every motion that is complete, with checksums of it and of its files."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from motionkit.core.checksums import checksum_of, sha256_of
from motionkit.core.errors import DamagedFileError
from motionkit.core.files import write_whole
from motionkit.core.timegrid import format_fps
from motionkit.export.files import TABLE, captions_json
from motionkit.generate.files import OutputFormat
from motionkit.generate.samples import GeneratedSample

# As motionkit.formats.scan.annotations reads them; seconds and num_frames are for people.
COLUMNS = ("file", "captions", "action", "fps", "seconds", "num_frames")
MEND = "delete it, and motionkit generate --resume makes all motions again"
FILES_CHECKSUM, ROW_CHECKSUM = "files_sha256", "checksum"

Row = dict[str, str]


@dataclass(frozen=True)
class GeneratedTable:
    """The table of a folder whose motions are written in a format; `has_checksums` is false in folders of before."""

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
        """All rows; a last line that was cut short is left out. Raises `DamagedFileError` where one is damaged."""
        columns, rows = self._read()
        if columns and tuple(columns) != self.columns:
            raise DamagedFileError(self.path, "its first line is not what was written", MEND)
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
        """The names of the columns and all rows, as they are."""
        if not self.path.is_file():
            return (), []
        data = self.path.read_bytes()
        text = data[: data.rfind(b"\n") + 1].decode("utf-8", errors="replace")
        # Where a row is too long or too short, csv gives None as a name or a cell.
        rows = csv.DictReader(io.StringIO(text, newline=""))
        try:
            found = [{str(name): str(cell) for name, cell in row.items()} for row in rows]
        except csv.Error as error:
            raise DamagedFileError(self.path, str(error), MEND) from None
        return rows.fieldnames or (), found

    def motion_names(self) -> list[str]:
        """The names of the motions in the table, of which nothing is checked; none where it is no table."""
        try:
            rows = self._read()[1]
        except DamagedFileError:
            return []
        return [PurePosixPath(row["file"]).stem for row in rows if _names_a_file(row)]

    def paths(self, row: Row) -> tuple[Path, ...]:
        """The files of a row's motion: by the name alone, so that none lies outside the folder."""
        return tuple(self.folder / place for place in self.output.files(PurePosixPath(row["file"]).stem))

    def fault(self, row: Row) -> str | None:
        """Why the files of a motion are not those that were written; None where they are, or nothing is known."""
        if not self.has_checksums or self._files_checksum(row) == row[FILES_CHECKSUM]:
            return None
        return "its content is not what its checksum says"

    def keep(self, rows: Sequence[Row]) -> None:
        """Leave the first rows of the table, and none after them."""
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
