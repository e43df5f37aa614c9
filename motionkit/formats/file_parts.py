"""A file read in parts, for files too long for memory; that it stays the same meanwhile is checked at every part."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from motionkit.errors import FormatError
from motionkit.formats import sourcefile

PART_BYTES = 1 << 16
LONGEST_LINE = 16 << 20


@dataclass(frozen=True)
class FileParts:
    """A file as it was when it was first looked at.

    Where its lines end in a carriage return alone, as those of old Macintoshes do, parts have newlines there.
    """

    path: Path
    size: int
    changed_ns: int
    old_line_ends: bool = False
    content: bytes | None = None

    @classmethod
    def of(cls, path: Path, *, held_bytes: int = 0) -> "FileParts":
        """Look at a file; one of at most `held_bytes` is read at once, whole, into `content`.

        Raises `FormatError` (`unreadable`, `empty`).
        """
        status = sourcefile.check_file(path)
        parts = cls(path, status.st_size, status.st_mtime_ns)
        if parts.size <= held_bytes:
            parts = replace(parts, content=parts.read(0, parts.size))
        if not any(part.strip(sourcefile.BLANK) for part in parts._all()):
            raise FormatError("the file is empty", path=path, reason="empty")
        return parts if any(b"\n" in part for part in parts._all()) else replace(parts, old_line_ends=True)

    def read(self, start: int, stop: int) -> bytes:
        """Bytes [start, stop); raises `FormatError` (`unreadable`, or `changed` since it was first looked at)."""
        data = self._from_disk(start, stop) if self.content is None else self.content[start:stop]
        return data.replace(b"\r", b"\n") if self.old_line_ends else data

    def _from_disk(self, start: int, stop: int) -> bytes:
        self._check_same()
        try:
            with self.path.open("rb") as file:
                file.seek(start)
                return file.read(stop - start)
        except OSError as error:
            raise sourcefile.unreadable(self.path, error) from None

    def _check_same(self) -> None:
        status = sourcefile.check_file(self.path)
        if (status.st_size, status.st_mtime_ns) != (self.size, self.changed_ns):
            raise FormatError("it was changed while it was read: call again", path=self.path, reason="changed")

    def line_blocks(self, start: int, stop: int, block_bytes: int) -> Iterator[tuple[int, bytes]]:
        """Pieces of [start, stop) of whole lines, about `block_bytes` long, each with the place of its first byte.

        Raises `FormatError` (`range`) for a line of more than 16 MiB.
        """
        rest = b""
        while start < stop:
            end = min(stop, start + len(rest) + block_bytes)
            data = rest + self.read(start + len(rest), end)
            whole = len(data) if end == stop else data.rfind(b"\n") + 1
            if whole:
                yield start, data[:whole]
            elif len(data) > LONGEST_LINE:
                message = (
                    f"a line of more than {LONGEST_LINE >> 20} MiB begins at byte {start}; expected lines of numbers"
                )
                raise FormatError(message, path=self.path, reason="range")
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
        """Hash of the file's bytes in hex; raises `FormatError` as `read` does."""
        if self.content is not None:
            return sourcefile.sha256(self.content)
        self._check_same()
        with self.path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def _all(self) -> Iterator[bytes]:
        for start in range(0, self.size, PART_BYTES):
            yield self.read(start, min(self.size, start + PART_BYTES))
