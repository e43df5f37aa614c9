"""What a file format is: how its files are found and read, how a motion is written."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from motionkit.core.motion import Motion
from motionkit.formats.bvh.document import BvhDocument
from motionkit.formats.scan.items import ReadOptions, ScanResult, SourceItem

Reader = Callable[[SourceItem, ReadOptions], Motion]


@dataclass(frozen=True)
class Format:
    """One format: how its files are found, how they are read, how a motion is written.

    A file format has `suffixes`, and `accepts` where the suffix alone does not tell; a single file of another name is
    known by a word that it `begins` with, comments aside. A folder format has `claims`, which says whether a folder is
    one, and `find`, which lists its sequences; a claimed folder is not searched further.
    `beside` lists the files of a folder, there or not, that belong to its sequences without being one: what is read
    with them, and what a data set is known to put there. `keys` names the sequences of a file that holds several. A
    text file that can be written again with its own lines has `document`, which reads the same skeleton, frames and
    clock as `read`, but frames where they are needed.

    `write` writes one motion to a file of the first of its `suffixes`. Where all files of a folder share a framerate
    and their joints, `shared_file` is the name of the file beside them that says which.
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
    write: Callable[[Motion, Path], None] | None = None
    shared_file: str = ""


def of_path(read: Callable[[Path, ReadOptions], Motion]) -> Reader:
    """A reader for which a file is all there is to a sequence."""
    return lambda item, options: read(item.path, options)
