"""Results of a scan and options of readers: small picklable values."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

from motionkit.core.errors import FormatError
from motionkit.core.motion import Caption
from motionkit.io.scan.cuts import Cut
from motionkit.io.scan.framerate_rules import FramerateRule


@dataclass(frozen=True)
class IndexOptions:
    """Which sequences of which indexes to read.

    `paths` are the indexes, `texts` a folder of captions (NAME.txt), `splits` one of train.txt, val.txt and test.txt.
    `mirrored` adds mirrored sequences; `published` takes only the frames that HumanML3D published, at 20 fps, with the
    bodies that its code used.
    """

    paths: tuple[Path, ...]
    texts: Path | None = None
    splits: Path | None = None
    mirrored: bool = False
    published: bool = False


@dataclass(frozen=True)
class ReadOptions:
    """Options of readers.

    `fps`, `unit_metres` (metres per file unit) and `up` (the axis x, y or z that points up) override the file and its
    annotations; `captions` is a CSV file of annotations whose cells replace those found beside the motions.
    `skeleton_maps` are the user's tables, as returned by `skeletons.families.read_skeleton_map`; a skeleton keeps the
    one that fits it. `fps_rules` are the user's corrections of framerates, before the shipped ones
    (`framerate_rules`). `body_models` is the user's folder of SMPL-family models. `index` selects stretches of a
    source's files. `skip_frames` frames are dropped at the start of every whole file whose annotations give no number.
    `skip_derived` skips the outputs of `motionkit complete` and `motionkit plant` in folders (`made`).
    """

    format: str = "auto"
    fps: Fraction | None = None
    unit_metres: float | None = None
    up: str = ""
    captions: Path | None = None
    skeleton_maps: tuple[str, ...] = ()
    fps_rules: tuple[FramerateRule, ...] = ()
    body_models: Path | None = None
    index: IndexOptions | None = None
    skip_frames: int = 0
    skip_derived: bool = False


@dataclass(frozen=True)
class SourceItem:
    """A sequence found by a scan; picklable, so that ingest can pass it to another process.

    `path` is the file that holds it, `root` the source folder, `key` the sequence's name inside a folder format (empty
    if a file holds one sequence). `fps` and `stated_fps` are those of an annotation; the file's own are read later.
    `cut` is the sequence's stretch of the file, None for all of it except its first `skip_frames` (None: the number in
    the options).
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


@dataclass(frozen=True)
class ScanResult:
    """The result of a scan: `items` to read, `problems` that lose a sequence, and `warnings` that do not.

    A motion without a caption, in a source with captions, is a warning: the motion is kept. `missing` counts, by
    dataset, the sequences of an index whose files are missing, `refused` those whose captions cannot be read; each is
    also one of the problems. `ignored` are the files of a folder that are not sequences and belong to none; it is empty
    for an index's folders.
    """

    items: tuple[SourceItem, ...]
    problems: tuple[FormatError, ...] = ()
    warnings: tuple[FormatError, ...] = field(default=())
    missing: Mapping[str, int] = field(default_factory=dict)
    refused: Mapping[str, int] = field(default_factory=dict)
    ignored: tuple[Path, ...] = ()
