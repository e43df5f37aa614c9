"""The description of a file format: how its files are found and read, and how a motion is written."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from motionkit.core.motion import Motion
from motionkit.io.bvh.document import BvhDocument
from motionkit.io.scan.items import ReadOptions, ScanResult, SourceItem

Reader = Callable[[SourceItem, ReadOptions], Motion]


@dataclass(frozen=True)
class Format:
    """A format: how its files are found, how they are read, how a motion is written.

    A file format has `suffixes`, and `accepts` if the suffix is ambiguous; a single file with another name is
    recognised by the word that it `begins` with, apart from comments. A folder format has `claims`, which recognises a
    folder, and `find`, which lists its sequences; a claimed folder is not searched further.
    `beside` lists possible files of a folder that belong to its sequences without being one: files read with them, and
    known files of the data set. `keys` names the sequences of a file that holds several. A text format whose files can
    be written again with their own lines has `document`, which reads the same skeleton, frames and clock as `read`, but
    frames on demand.

    `turns_up` is whether `read` applies `ReadOptions.up`; motions of other formats are turned after they are read.

    `write` writes one motion to a file of the first of its `suffixes`. If all files of a folder share framerate and
    joints, `shared_file` is the name of the file beside them that states these.
    """

    name: str
    read: Reader | None = None
    suffixes: tuple[str, ...] = ()
    accepts: Callable[[Path], bool] | None = None
    begins: bytes = b""
    claims: Callable[[Path], bool] | None = None
    find: Callable[[Path, Path], ScanResult] | None = None
    beside: Callable[[Path], Iterable[Path]] = lambda folder: ()
    keys: Callable[[Path], tuple[str, ...]] = lambda path: ()
    document: Callable[[Path, ReadOptions], BvhDocument] | None = None
    turns_up: bool = False
    write: Callable[[Motion, Path], None] | None = None
    shared_file: str = ""


def of_path(read: Callable[[Path, ReadOptions], Motion]) -> Reader:
    """A reader of sequence items from a reader of paths, for formats with one sequence per file."""
    return lambda item, options: read(item.path, options)
