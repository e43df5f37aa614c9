"""What a file format is, and which formats there are: recognising files, finding readers, writing motions.

Motionkit's own formats are loaded when a file may be of them, those that a package lists in `FORMATS`
(`motionkit.core.plugins`) at once.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache, cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

from motionkit.core import plugins
from motionkit.core.errors import FormatError, UsageError
from motionkit.core.files import whole_file
from motionkit.core.motion import Caption, Motion
from motionkit.io import npy, source_file
from motionkit.io.cuts import Cut


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
class FramerateRule:
    """Files whose framerate is `fps` although they state `stated` (None: any).

    `where` names the rule for logs: its file's name and its number.
    """

    files: tuple[str, ...]
    fps: Fraction
    stated: Fraction | None
    source: str
    where: str


@dataclass(frozen=True)
class ReadOptions:
    """Options of readers.

    `fps`, `unit_metres` (metres per file unit) and `up` (the axis x, y or z that points up) override the file and its
    annotations; `captions` is a CSV file of annotations whose cells replace those found beside the motions.
    `skeleton_maps` are the user's tables, as returned by `skeletons.mapping.read_skeleton_map`; a skeleton keeps the
    one that fits it. `fps_rules` are the user's corrections of framerates, before the shipped ones
    (`motionkit.io.scan`). `body_models` is the user's folder of SMPL-family models. `index` selects segments of a
    source's files. `skip_frames` frames are dropped at the start of every whole file whose annotations give no number.
    `skip_derived` ignores the outputs of `motionkit complete` and `motionkit plant` in folders. With `fill_missing`,
    frames of .npz and .npy arrays that hold NaN repeat the last valid one; they are refused otherwise.
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
    fill_missing: bool = False


@dataclass(frozen=True)
class SourceItem:
    """A sequence found by a scan; picklable, so that ingest can pass it to another process.

    `path` is the file that holds it, `root` the source folder, `key` the sequence's name inside a folder format (empty
    if a file holds one sequence). `fps` and `stated_fps` are those of an annotation; the file's own are read later.
    `cut` is the sequence's segment of the file, None for all of it except its first `skip_frames` (None: the number in
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


@dataclass(frozen=True)
class ScanResult:
    """The result of a scan: `items` to read, `problems` that lose a sequence, and `warnings` that do not.

    `missing` counts, by dataset, the sequences of an index whose files are missing; each is also one of the problems.
    `ignored` are the files of a folder that are not sequences and belong to none; it is empty for an index's folders.
    """

    items: tuple[SourceItem, ...]
    problems: tuple[FormatError, ...] = ()
    warnings: tuple[FormatError, ...] = ()
    missing: Mapping[str, int] = field(default_factory=dict)
    ignored: tuple[Path, ...] = ()


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


Reader = Callable[[SourceItem, ReadOptions], Motion]


@dataclass(frozen=True)
class Format:
    """A format: how its files are recognised and read, and how a motion is written.

    A file format has `suffixes`, and `accepts` if the suffix is ambiguous. A folder format has `claims`, which
    recognises a folder, and `find`, which lists its sequences; a claimed folder is not searched further. `keys` names
    the sequences of a file that holds several. A text format whose files can be written again with their own lines has
    `document`, which reads the same motion as `read`, with the file's text.

    `turns_up` is whether `read` applies `ReadOptions.up`; motions of other formats are turned after they are read.

    `write` writes one motion to a file of the first of its `suffixes`. If all files of a folder share framerate and
    joints, `shared_file` is the name of the file beside them that states these.
    """

    name: str
    read: Reader | None = None
    suffixes: tuple[str, ...] = ()
    accepts: Callable[[FileHead], bool] = lambda head: True
    claims: Callable[[Path], bool] | None = None
    find: Callable[[Path, Path], ScanResult] | None = None
    keys: Callable[[FileHead], tuple[str, ...]] = lambda head: ()
    document: Callable[[Path, ReadOptions], Any] | None = None
    turns_up: bool = False
    write: Callable[[Motion, Path], None] | None = None
    shared_file: str = ""


def of_path(read: Callable[[Path, ReadOptions], Motion]) -> Reader:
    """A reader of sequence items from a reader of paths, for formats with one sequence per file."""
    return lambda item, options: read(item.path, options)


def of_document(read: Callable[..., Any]) -> Reader:
    """A reader of sequence items from a format's `document`, which is strict here."""
    return lambda item, options: read(item.path, options, strict=True).motion


@dataclass(frozen=True)
class _BuiltIn:
    """What is known of a format before its module is loaded.

    `suffixes` are those of the files that it reads, whose names without suffix match `stem` in any case; a folder may
    be of a folder format if it has an entry that matches one of the patterns `holds`. Files of another format may look
    like those of one `by_name`, which is not tried unless it is named.
    """

    name: str
    module: str
    variable: str = "FORMAT"
    suffixes: tuple[str, ...] = ()
    stem: str = ".*"
    holds: tuple[str, ...] = ()
    writes: bool = False
    by_name: bool = False

    def load(self) -> Format:
        found = getattr(import_module(f"motionkit.io.{self.module}"), self.variable)
        loaded: Format = found[self.name] if isinstance(found, dict) else found
        return loaded


_POSE_FOLDERS = ("new_joints", "new_joint_vecs")
# ViMoGen's vectors have DART's width, and FlowMDM's of BABEL that of motion-135.
NAMED_VECTORS = ("motion-135", "flowmdm-135", "dart-276", "vimogen-276")
# The first that accepts a file reads it.
_BUILT_IN = (
    _BuiltIn("lafan1", "bvh_data_sets", "LAFAN1_FORMAT", suffixes=(".bvh",), stem=r".*_subject\d+"),
    _BuiltIn("100style", "bvh_data_sets", "STYLE100_FORMAT", suffixes=(".bvh",), stem=r".*_([BFS][RW]|ID|TR[123])"),
    _BuiltIn("bvh", "bvh", suffixes=(".bvh",), writes=True),
    _BuiltIn("asfamc", "asfamc", suffixes=(".amc",)),
    _BuiltIn("c3d", "markers", "C3D_FORMAT", suffixes=(".c3d",)),
    _BuiltIn("trc", "markers", "TRC_FORMAT", suffixes=(".trc",)),
    _BuiltIn("deepmimic", "deepmimic", suffixes=(".txt", ".json")),
    _BuiltIn("uestc", "uestc", suffixes=(".npz",)),
    _BuiltIn("kimodo", "kimodo", suffixes=(".npz",)),
    _BuiltIn("smpl", "smpl", suffixes=(".npz",)),
    _BuiltIn("motion-x", "smpl", "MOTION_X_FORMAT", suffixes=(".npy",)),
    _BuiltIn("amass", "amass", suffixes=(".npz",), writes=True),
    _BuiltIn("humanml3d", "humanml3d", holds=_POSE_FOLDERS),
    _BuiltIn("kit", "humanml3d", "KIT_FORMAT", holds=_POSE_FOLDERS),
    _BuiltIn("easymocap", "easymocap", holds=("[0-9]*.json",)),
    _BuiltIn("humanact12", "joints_npy", "HUMANACT12_FORMAT", suffixes=(".npy",)),
    _BuiltIn("joints-npy", "joints_npy", suffixes=(".npy",), writes=True),
    _BuiltIn("npz", "npz", suffixes=(".npz",), writes=True),
    _BuiltIn("pose-vectors", "pose_vectors", suffixes=(".npy",)),
    _BuiltIn("interhuman", "pose_vectors", "INTERHUMAN_FORMAT", suffixes=(".npy",)),
    _BuiltIn("motionstreamer", "pose_vectors", "MOTIONSTREAMER_FORMAT", suffixes=(".npy",)),
    *(
        _BuiltIn(name, "vector_layouts", "FORMATS", suffixes=(".npy",), by_name=name in NAMED_VECTORS)
        for name in ("hymotion-201", "ardy-330", "ardy-g1-414", "g1-38", *NAMED_VECTORS)
    ),
    _BuiltIn("motius", "vector_layouts", "MOTIUS_FORMAT", suffixes=(".npz",)),
    *(
        _BuiltIn(name, "g1_csv", "FORMATS", suffixes=(".csv",), by_name=name != "g1-csv")
        for name in ("g1-csv", "g1-csv-wxyz", "g1-csv-xyzw")
    ),
    _BuiltIn("csv", "joints_csv", suffixes=(".csv",), writes=True),
    _BuiltIn("robot-csv", "robot_csv", writes=True),
    _BuiltIn("gltf", "gltf", suffixes=(".glb",), writes=True),
)


@cache
def _installed() -> tuple[Format, ...]:
    # Ours are built in.
    return tuple(plugins.load_all("FORMATS", foreign=True).values())


@cache
def readers() -> Mapping[str, Format]:
    """All formats with a reader, by name, in the order in which they are tried: installed ones first."""
    every = (*_installed(), *(each.load() for each in _BUILT_IN))
    return {each.name: each for each in every if each.read is not None}


@cache
def writers() -> Mapping[str, Format]:
    """The formats that write one motion per file, by name."""
    every = (*_installed(), *(each.load() for each in _BUILT_IN if each.writes))
    return {each.name: each for each in every if each.write is not None}


@cache
def reader_of(name: str) -> Format:
    """The format of this name; raises `UsageError` for an unknown one."""
    installed = (each for each in _installed() if each.name == name and each.read is not None)
    found = next(installed, None) or next((each.load() for each in _BUILT_IN if each.name == name), None)
    if found is None or found.read is None:
        raise UsageError(f"unknown format {name!r}, expected auto or one of {', '.join(readers())}")
    return found


def recognise(head: FileHead, name: str = "auto") -> Format | None:
    """The format of a file by its suffix, then its content; None for any other file, and for formats not of `name`."""
    suffix = head.path.suffix.lower()

    def candidates() -> Iterator[Format]:
        yield from (each for each in _installed() if suffix in each.suffixes and each.read is not None)
        for each in _BUILT_IN:
            if each.by_name and name == "auto":
                continue
            if suffix in each.suffixes and re.fullmatch(each.stem, head.path.stem, re.DOTALL | re.IGNORECASE):
                yield reader_of(each.name)

    return next((each for each in candidates() if name in ("auto", each.name) and each.accepts(head)), None)


def recognise_folder(folder: Path, name: str = "auto") -> Format | None:
    """The format whose data set a folder is, None for any other folder and for formats not of `name`."""

    def candidates() -> Iterator[Format]:
        yield from _installed()
        for each in _BUILT_IN:
            if any(next(folder.glob(pattern), None) for pattern in each.holds):
                yield reader_of(each.name)

    kinds = (each for each in candidates() if name in ("auto", each.name))
    return next((each for each in kinds if each.claims is not None and each.claims(folder)), None)


def writer_of(suffix: str) -> Callable[[Motion, Path], None]:
    """The function that writes a motion to a file of this suffix: of several formats, that of the suffix's name.

    Raises `UsageError` for a suffix that no format writes.
    """
    fitting = {each.name: each.write for each in writers().values() if each.suffixes[0] == suffix and each.write}
    if not fitting:
        suffixes = ", ".join(sorted({each.suffixes[0] for each in writers().values()}))
        raise UsageError(f"a motion is written as {suffixes}, by the suffix of the file's name, not as {suffix!r}")
    return fitting.get(suffix[1:]) or next(iter(fitting.values()))


def write(motion: Motion, path: str | Path) -> None:
    """Write a motion to a file; the suffix selects the format.

    - `.npz`: all of the motion, lossless
    - `.bvh`: the skeleton and its rotations, in centimetres; by inverse kinematics if the motion has none
    - `.glb`: glTF, an animated skeleton with a visible body, for engines and viewers
    - `.csv`: time stamps and joint positions in metres
    - `.npy`: joint positions [T, J, 3] in metres of the 22 joints (KIT-ML's 21 if the motion has these), the
      framerate in `motions.json` beside the file

    Folders are created, an existing file is replaced, and the file is written atomically. Raises `UsageError` for any
    other suffix, `ValueError` for an `.npy` beside those of another framerate, `MotionkitError` for one of a skeleton
    that cannot be mapped to the 22 joints, and `OSError`.

    >>> motion = mk.read("walk.bvh")
    >>> mk.write(motion, "out/walk.npz")
    >>> mk.read("out/walk.npz").num_frames
    240
    """
    path = Path(path)
    write_file = writer_of(path.suffix.lower())
    with whole_file(path) as temporary:
        write_file(motion, temporary)
