"""The description of a file format: how its files are recognised and read, and how a motion is written."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion
from motionkit.io import npy
from motionkit.io.bvh.document import BvhDocument
from motionkit.io.scan.items import ReadOptions, ScanResult, SourceItem
from motionkit.io.source import source_file

Reader = Callable[[SourceItem, ReadOptions], Motion]


@dataclass(frozen=True)
class FileHead:
    """A file's path and what its beginning says, read when first needed and once for all formats."""

    path: Path

    @cached_property
    def content(self) -> bytes:
        """The first 16 KiB; empty if the file cannot be read."""
        try:
            with self.path.open("rb") as file:
                return file.read(npy.HEADER_BYTES)
        except OSError:
            return b""

    @cached_property
    def array_shape(self) -> tuple[int, ...] | None:
        """The shape of a .npy array; None without a valid header."""
        return npy.peek_shape(self.path)

    @cached_property
    def array_names(self) -> frozenset[str]:
        """The names of an .npz file's arrays; empty without a valid zip directory."""
        return npy.peek_keys(self.path)

    @cached_property
    def column_names(self) -> list[str]:
        """The names in a table's first line; empty if the file cannot be read, which annotations report."""
        try:
            return source_file.header_names(self.path)
        except FormatError:
            return []


@dataclass(frozen=True)
class Format:
    """A format: how its files are recognised and read, and how a motion is written.

    A file format has `suffixes`, and `accepts` if the suffix is ambiguous; a single file with another name is
    recognised by the word that it `begins` with, apart from comments. A folder format has `claims`, which recognises a
    folder, and `find`, which lists its sequences; a claimed folder is not searched further.
    `beside` are names, or patterns of names, of other files that belong to a folder of its sequences. `keys` names the
    sequences of a file that holds several. A text format whose files can be written again with their own lines has
    `document`, which reads the same skeleton, frames and clock as `read`, but frames on demand.

    `turns_up` is whether `read` applies `ReadOptions.up`; motions of other formats are turned after they are read.

    `write` writes one motion to a file of the first of its `suffixes`. If all files of a folder share framerate and
    joints, `shared_file` is the name of the file beside them that states these.
    """

    name: str
    read: Reader | None = None
    suffixes: tuple[str, ...] = ()
    accepts: Callable[[FileHead], bool] = lambda head: True
    begins: bytes = b""
    claims: Callable[[Path], bool] | None = None
    find: Callable[[Path, Path], ScanResult] | None = None
    beside: tuple[str, ...] = ()
    keys: Callable[[FileHead], tuple[str, ...]] = lambda head: ()
    document: Callable[[Path, ReadOptions], BvhDocument] | None = None
    turns_up: bool = False
    write: Callable[[Motion, Path], None] | None = None
    shared_file: str = ""


def of_path(read: Callable[[Path, ReadOptions], Motion]) -> Reader:
    """A reader of sequence items from a reader of paths, for formats with one sequence per file."""
    return lambda item, options: read(item.path, options)
