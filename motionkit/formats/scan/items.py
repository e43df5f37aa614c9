"""What a scan finds, and the options of readers: small values that travel between processes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

from motionkit.core.errors import FormatError
from motionkit.core.motion import Caption
from motionkit.formats.scan.cuts import Cut
from motionkit.formats.scan.framerate_rules import FramerateRule


@dataclass(frozen=True)
class IndexOptions:
    """Which sequences of which indexes are wanted.

    `paths` are the indexes, `texts` a folder of captions (NAME.txt), `splits` one of train.txt, val.txt and test.txt.
    `mirrored` adds mirrored sequences; `published` takes the frames that HumanML3D published, at 20 fps, not all, and
    gives them the bodies that its code gave them.
    """

    paths: tuple[Path, ...]
    texts: Path | None = None
    splits: Path | None = None
    mirrored: bool = False
    published: bool = False


@dataclass(frozen=True)
class ReadOptions:
    """How sources are to be read.

    `fps` and `unit_metres` (metres per file unit) replace whatever the file or its annotations say; `captions` is a CSV
    file of annotations that replaces those found beside the motions. `skeleton_maps` are the user's tables as
    `skeletons.families.read_skeleton_map` gives them; a skeleton that one of them fits takes it along.
    `fps_rules` are the user's corrections of framerates, before the shipped ones (`framerate_rules`). `body_models` is
    the user's folder of SMPL-family models. `index` picks stretches of a source's files. `skip_frames` at the start of
    every whole file are left out, where its annotations don't say how many. Of folders, `leave_out_made` leaves out the
    files that `motionkit complete` and `motionkit plant` have put there (`made`).
    """

    format: str = "auto"
    fps: Fraction | None = None
    unit_metres: float | None = None
    captions: Path | None = None
    skeleton_maps: tuple[str, ...] = ()
    fps_rules: tuple[FramerateRule, ...] = ()
    body_models: Path | None = None
    index: IndexOptions | None = None
    skip_frames: int = 0
    leave_out_made: bool = False


@dataclass(frozen=True)
class SourceItem:
    """One sequence that a scan found; picklable, so that ingest can hand it to another process.

    `path` is the file that holds it, `root` the source folder, `key` the sequence's name inside a folder format (empty
    where a file holds one sequence). `fps` and `stated_fps` are what an annotation says; the file's own are read later.
    `cut` is the stretch of the file that the sequence is, None for all of it but for its first `skip_frames` (None: as
    many as the options say).
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
    stated_fps: str = ""
    source: str = ""
    subset: str = ""
    licence: str = ""
    cut: Cut | None = None
    skip_frames: int | None = None
    mirrored: bool = False

    def __str__(self) -> str:
        return f"{self.path} ({self.key})" if self.key else str(self.path)


@dataclass(frozen=True, eq=False)
class Spare:
    """A sequence whose id an earlier one has: to be read where that one cannot be, and otherwise the `problem`."""

    item: SourceItem
    problem: FormatError


@dataclass(frozen=True)
class ScanResult:
    """What a scan found: `items` to read, `problems` that cost a sequence, and `warnings` that cost none.

    A motion without a caption, in a source that has captions, is a warning: the motion is kept. `missing` counts, by
    dataset, the sequences of an index whose files are not there, `refused` those whose captions cannot be read; each is
    one of the problems too, as are those of the `spares`. `ignored` are the files of a folder that are no sequences and
    belong to none; of an index's folders there are none.
    """

    items: tuple[SourceItem, ...]
    problems: tuple[FormatError, ...] = ()
    warnings: tuple[FormatError, ...] = field(default=())
    missing: Mapping[str, int] = field(default_factory=dict)
    refused: Mapping[str, int] = field(default_factory=dict)
    spares: tuple[Spare, ...] = ()
    ignored: tuple[Path, ...] = ()
