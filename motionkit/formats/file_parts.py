"""A file read in parts, for files too long for memory; that it stays the same meanwhile is checked at every part."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from motionkit.errors import FormatError
from motionkit.formats import sourcefile

PART_BYTES = 1 << 16


@dataclass(frozen=True)
class FileParts:
    """A file as it was when it was first looked at.

    Where its lines end in a carriage return alone, as those of old Macintoshes do, parts have newlines there.
    """

    path: Path
    size: int
    changed_ns: int
    old_line_ends: bool

    @classmethod
    def of(cls, path: Path) -> "FileParts":
        """Look at a file; raises `FormatError` (`unreadable`, `empty`)."""
        status = sourcefile.check_file(path)
        parts = cls(path, status.st_size, status.st_mtime_ns, old_line_ends=False)
        if not any(part.strip(sourcefile.BLANK) for part in parts._all()):
            raise FormatError("the file is empty", path=path, reason="empty")
        return parts if any(b"\n" in part for part in parts._all()) else cls(*parts._key(), old_line_ends=True)

    def read(self, start: int, stop: int) -> bytes:
        """Bytes [start, stop); raises `FormatError` (`unreadable`, or `changed` since it was first looked at)."""
        status = sourcefile.check_file(self.path)
        if (status.st_size, status.st_mtime_ns) != (self.size, self.changed_ns):
            raise FormatError("it was changed while it was read: call again", path=self.path, reason="changed")
        try:
            with self.path.open("rb") as file:
                file.seek(start)
                data = file.read(stop - start)
        except OSError as error:
            raise sourcefile.unreadable(self.path, error) from None
        return data.replace(b"\r", b"\n") if self.old_line_ends else data

    def line_blocks(self, start: int, stop: int, block_bytes: int) -> Iterator[tuple[int, bytes]]:
        """Pieces of [start, stop) of whole lines, about `block_bytes` long, each with the place of its first byte."""
        rest = b""
        while start < stop:
            end = min(stop, start + len(rest) + block_bytes)
            data = rest + self.read(start + len(rest), end)
            whole = len(data) if end == stop else data.rfind(b"\n") + 1
            if whole:
                yield start, data[:whole]
            start, rest = start + whole, data[whole:]

    def end_of_text(self) -> int:
        """Where the last line that is not blank ends."""
        stop = self.size
        while stop:
            part = self.read(max(0, stop - PART_BYTES), stop)
            if kept := len(part.rstrip()):
                return stop - len(part) + kept
            stop -= len(part)
        return 0

    def sha256(self) -> str:
        """Hash of the file's bytes in hex."""
        with self.path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def _all(self) -> Iterator[bytes]:
        for start in range(0, self.size, PART_BYTES):
            yield self.read(start, min(self.size, start + PART_BYTES))

    def _key(self) -> tuple[Path, int, int]:
        return self.path, self.size, self.changed_ns
