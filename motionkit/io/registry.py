"""What a file format is, and which formats there are: recognising files, finding readers, writing motions.

Motionkit's own formats are listed here; a package lists its formats in `FORMATS` (`motionkit.core.plugins`).
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache, cached_property
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

    @property
    def row_width(self) -> int:
        """Numbers in a row of an array [T, D], or of [1, T, D], a batch of one; 0 for other arrays."""
        match self.array_shape:
            case (_, width) | (1, _, width):
                return width
        return 0

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

    A file format has `suffixes`, and `accepts` if the suffix is ambiguous; one `by_name`, whose files look like those
    of another, is not tried unless it is named. A folder format has `claims`, which recognises a folder, and `find`,
    which lists its sequences; a claimed folder is not searched further. `keys` names the sequences of a file that holds
    several. A text format whose files can be written again with their own lines has `document`, which reads the same
    motion as `read`, with the file's text.

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
    by_name: bool = False


def _ours(
    name: str, suffixes: str = "", *, module: str = "", stem: str = ".*", holds: str = "", **fields: Any
) -> Format:
    """A format by names of functions in a module of this package, which is imported when one of them is called.

    The module has the format's name, with underscores, unless it is given. `read_path` reads a file's path in
    place of a `SourceItem`, and so does `document`, which is strict for `read`. `accepts` is called for files whose
    name without suffix matches `stem` in any case, `claims` for folders with an entry that one of the patterns `holds`
    matches.
    """
    for key in ("read", "read_path", "document", "accepts", "claims", "find", "keys", "write"):
        if isinstance(fields.get(key), str):
            fields[key] = plugins.lazily(f"{__package__}.{module or name.replace('-', '_')}:{fields[key]}")
    if (read_path := fields.pop("read_path", None)) is not None:
        fields["read"] = lambda item, options: read_path(item.path, options)
    if (document := fields.get("document")) is not None:
        fields["read"] = lambda item, options: document(item.path, options, strict=True).motion
    if (accepts := fields.get("accepts")) is not None:
        fits = re.compile(stem, re.DOTALL | re.IGNORECASE).fullmatch
        fields["accepts"] = lambda head: fits(head.path.stem) is not None and accepts(head)
    if (claims := fields.get("claims")) is not None:
        fields["claims"] = lambda folder: any(any(folder.glob(each)) for each in holds.split()) and claims(folder)
    return Format(name, suffixes=tuple(suffixes.split()), **fields)


def _rows_of(*widths: int) -> Callable[[FileHead], bool]:
    return lambda head: head.row_width in widths


_POSE_FOLDERS = "new_joints new_joint_vecs"
# Names of vectors end with the width of their rows: ViMoGen's have DART's, and FlowMDM's of BABEL that of motion-135.
NAMED_VECTORS = ("motion-135", "flowmdm-135", "dart-276", "vimogen-276")
_VECTORS = ("hymotion-201", "ardy-330", "ardy-g1-414", "g1-38", *NAMED_VECTORS)
_LAFAN1, _STYLE100 = r".*_subject\d+", r".*_([BFS][RW]|ID|TR[123])"
# The first that accepts a file reads it.
_BUILT_IN = (
    _ours(
        "lafan1",
        ".bvh",
        module="bvh_data_sets",
        document="read_lafan1",
        stem=_LAFAN1,
        accepts="is_lafan1",
        turns_up=True,
    ),
    _ours(
        "100style",
        ".bvh",
        module="bvh_data_sets",
        document="read_100style",
        stem=_STYLE100,
        accepts="is_100style",
        turns_up=True,
    ),
    _ours("bvh", ".bvh", document="read_document", write="write_bvh", turns_up=True),
    _ours("asfamc", ".amc", read_path="read_asfamc"),
    _ours("c3d", ".c3d", module="markers", read_path="read_c3d", turns_up=True),
    _ours("trc", ".trc", module="markers", read_path="read_trc", turns_up=True),
    _ours("deepmimic", ".txt .json", read_path="read_deepmimic", accepts="accepts"),
    _ours("uestc", ".npz", read_path="read_uestc", accepts="accepts"),
    _ours("kimodo", ".npz", read_path="read_kimodo", accepts=lambda head: "posed_joints" in head.array_names),
    _ours("smpl", ".npz", read_path="read_smpl", accepts="accepts", turns_up=True),
    _ours("motion-x", ".npy", module="smpl", read_path="read_motion_x", accepts=_rows_of(322), turns_up=True),
    _ours("amass", ".npz", read="read_amass", accepts="accepts", write="write_amass", turns_up=True),
    _ours("humanml3d", read="read_humanml3d", holds=_POSE_FOLDERS, claims="is_humanml3d", find="find"),
    _ours("kit", module="humanml3d", read="read_humanml3d", holds=_POSE_FOLDERS, claims="is_kit", find="find"),
    _ours("easymocap", read="read_easymocap", holds="[0-9]*.json", claims="claims", find="find", turns_up=True),
    _ours("humanact12", ".npy", module="joints_npy", read_path="read_humanact12", accepts="is_humanact12"),
    _ours(
        "joints-npy",
        ".npy",
        read_path="read_joints_npy",
        accepts="accepts",
        write="write_joints_npy",
        turns_up=True,
        shared_file="motions.json",
    ),
    _ours("npz", ".npz", read_path="read_npz", accepts="accepts", write="write_npz"),
    _ours("pose-vectors", ".npy", read_path="read_pose_vectors", accepts=_rows_of(263, 251)),
    _ours(
        "interhuman",
        ".npy",
        module="pose_vectors",
        read="read_interhuman",
        accepts="is_interhuman",
        keys="persons",
        turns_up=True,
    ),
    _ours("motionstreamer", ".npy", module="pose_vectors", read_path="read_motionstreamer", accepts=_rows_of(272)),
    *(
        _ours(
            name,
            ".npy",
            module="vector_layouts",
            read="read_vectors",
            accepts=_rows_of(int(name.rpartition("-")[2])),
            turns_up=True,
            by_name=name in NAMED_VECTORS,
        )
        for name in _VECTORS
    ),
    _ours(
        "motius",
        ".npz",
        module="vector_layouts",
        read="read_vectors",
        accepts=lambda head: "motion_135" in head.array_names,
        turns_up=True,
    ),
    _ours("g1-csv", ".csv", read="read_g1_csv", accepts="accepts", turns_up=True),
    _ours("g1-csv-wxyz", ".csv", module="g1_csv", read="read_g1_csv", accepts="accepts", turns_up=True, by_name=True),
    _ours("g1-csv-xyzw", ".csv", module="g1_csv", read="read_g1_csv", accepts="accepts", turns_up=True, by_name=True),
    _ours("csv", ".csv", module="joints_csv", read_path="read_joints_csv", accepts="accepts", write="write_joints_csv"),
    _ours("robot-csv", ".csv", write="write_robot_csv"),
    _ours("gltf", ".glb", read_path="read_gltf", write="write_gltf"),
)


@cache
def formats() -> Mapping[str, Format]:
    """All formats by name, in the order in which they are tried: installed ones first."""
    found = plugins.load_all("FORMATS", foreign=True)  # ours are built in
    by_name: dict[str, Format] = {}
    for each in (*found.values(), *_BUILT_IN):
        by_name.setdefault(each.name, each)
    return by_name


def readers() -> Mapping[str, Format]:
    """The formats that are read, by name."""
    return {name: each for name, each in formats().items() if each.read is not None}


def writers() -> Mapping[str, Format]:
    """The formats that write one motion per file, by name."""
    return {name: each for name, each in formats().items() if each.write is not None}


def reader_of(name: str) -> Format:
    """The format of this name; raises `UsageError` for an unknown one."""
    if name not in readers():
        raise UsageError(f"unknown format {name!r}, expected auto or one of {', '.join(readers())}")
    return readers()[name]


def recognise(head: FileHead, name: str = "auto") -> Format | None:
    """The format of a file by its suffix, then its content; None for any other file, and for formats not of `name`."""
    suffix = head.path.suffix.lower()
    tried = (each for each in readers().values() if each.name == name or (name == "auto" and not each.by_name))
    return next((each for each in tried if suffix in each.suffixes and each.accepts(head)), None)


def recognise_folder(folder: Path, name: str = "auto") -> Format | None:
    """The format whose data set a folder is, None for any other folder and for formats not of `name`."""
    kinds = (each for each in readers().values() if name in ("auto", each.name))
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
