"""What a scan finds and what a reader is told: small values that travel between processes."""

from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

from motionkit.errors import FormatError
from motionkit.motion import Caption


@dataclass(frozen=True)
class ReadOptions:
    """How sources are to be read.

    `fps` and `unit_metres` (metres per file unit) replace whatever the file or its annotations say; `captions` is a CSV
    file of annotations that replaces those found beside the motions. `skeleton_maps` are the user's tables as
    `skeleton_families.read_skeleton_map` gives them; a skeleton that one of them fits takes it along.
    """

    format: str = "auto"
    fps: Fraction | None = None
    unit_metres: float | None = None
    captions: Path | None = None
    skeleton_maps: tuple[str, ...] = ()


@dataclass(frozen=True)
class SourceItem:
    """One sequence that a scan found; picklable, so that ingest can hand it to another process.

    `path` is the file that holds it, `root` the source folder, `key` the sequence's name inside a folder format (empty
    where a file holds one sequence). `fps` is what an annotation says; the file's own framerate is read later.
    """

    format: str
    path: Path
    root: Path
    sequence_id: str
    key: str = ""
    captions: tuple[Caption, ...] = ()
    action: str = ""
    style: str = ""
    subject: str = ""
    split: str = ""
    fps: Fraction | None = None
    source: str = ""
    subset: str = ""
    licence: str = ""

    def __str__(self) -> str:
        return f"{self.path} ({self.key})" if self.key else str(self.path)


@dataclass(frozen=True)
class ScanResult:
    """What a scan found: `items` to read, `problems` that cost a sequence, and `warnings` that cost none.

    A motion without a caption, in a source that has captions, is a warning: the motion is kept.
    """

    items: tuple[SourceItem, ...]
    problems: tuple[FormatError, ...] = ()
    warnings: tuple[FormatError, ...] = field(default=())
