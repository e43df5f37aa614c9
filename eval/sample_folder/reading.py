"""Reading a folder of samples: every motion that can be read, and a list of those that cannot."""

import os
import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from functools import cache
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from eval.sample_folder.arrays import StoredMotion, read_stored
from eval.sample_folder.folder import SampleFolder, SampleFolderError, SampleMotion, left_out_line
from motionkit.core.errors import FormatError, counted, describe, shown
from motionkit.core.files import parse_toml, whole_number
from motionkit.core.motion import Motion
from motionkit.core.progress import OnProgress, ignore, task
from motionkit.core.shapes import Float, Float32
from motionkit.core.skeleton import KIT21, SMPL22
from motionkit.core.skeletons.mapping import SkeletonMapError, joint_map, map_joints
from motionkit.core.timegrid import TimeGrid, parse_fps
from motionkit.features.layout import layout_of
from motionkit.features.statistics import Statistics
from motionkit.io import annotations, body_frame, humanml3d, joints_npy, npy, source_file, texts
from motionkit.io.registry import NAMED_VECTORS, ReadOptions, SourceItem
from motionkit.io.scan import read, scan

MANIFEST = "samples.toml"
RAW, NORMALISED = "raw", "normalised"
CHOICES = {"up": body_frame.GIVEN_AXES, "statistics": (RAW, NORMALISED), "vectors": NAMED_VECTORS}


@dataclass(frozen=True)
class Manifest:
    """A folder's `samples.toml`; every key is optional if the files state it.

    `files` and `exclude` are globs below the folder. `fps` and `unit_metres` override the files; `up` is the vertical
    axis. `vectors` names the layout of vectors whose width is not unique. `statistics` is `raw` or `normalised` for
    263 or 251 numbers, `mean` and `std` the .npy files they were normalised with. `prompts` is a text file whose line k
    (from 0) is the caption of group k.
    """

    files: tuple[str, ...] = ()
    exclude: tuple[str, ...] | None = None
    fps: Fraction | None = None
    unit_metres: float | None = None
    up: str = ""
    vectors: str = ""
    statistics: str = ""
    mean: Path | None = None
    std: Path | None = None
    prompts: Path | None = None


def read_manifest(folder: Path) -> Manifest:
    """Read `folder/samples.toml`, whose paths may not leave the folder; an absent one is like an empty one.

    Raises `FormatError` (`manifest`).
    """
    path = folder / MANIFEST
    if not path.is_file() or not path.stat().st_size:
        return Manifest()

    def fault(message: str) -> FormatError:
        return FormatError(message[:400], path=path, reason="manifest")

    try:
        stated = parse_toml(source_file.decode(source_file.read_bytes(path), path))
    except ValueError as error:
        raise fault(f"not TOML ({error})") from None
    known = [field.name for field in fields(Manifest)]
    values: dict[str, Any] = {}
    for key, value in stated.items():
        if key not in known:
            raise fault(f"unknown key {shown(key)}, expected any of {', '.join(known)}")
        try:
            values[key] = _value(key, value, folder)
        except (ValueError, TypeError, OSError) as error:
            raise fault(f"{key} = {shown(value)}: {describe(error)}") from None
    manifest = Manifest(**values)
    if (manifest.statistics == NORMALISED) != (manifest.mean is not None and manifest.std is not None):
        raise fault(
            'statistics = "normalised" needs mean = "….npy" and std = "….npy", the files that the model was '
            "trained with, and they need it"
        )
    return manifest


def _value(key: str, value: Any, folder: Path) -> Any:
    """The value of one key; raises `ValueError`, `TypeError` or `OSError` that says what was expected."""
    match key:
        case "fps":
            if type(value) not in (int, float, str):
                raise TypeError('expected a framerate such as 20, 12.5 or "30000/1001"')
            return parse_fps(value)
        case "unit_metres":
            if type(value) not in (int, float) or not 0 < value < 1e6:
                raise TypeError("expected the length of the files' unit in metres, such as 0.01")
            return float(value)
        case "files" | "exclude":
            globs = [value] if isinstance(value, str) else value
            if not isinstance(globs, list) or not all(isinstance(glob, str) and glob for glob in globs):
                raise TypeError('expected a glob or a list of globs, such as ["*_pred.npy"]')
            # A glob matches the end of a path, whatever the folders before it.
            globs = [glob.removeprefix("**/") for glob in globs]
            for glob in globs:
                PurePath().match(glob)  # raises ValueError for an empty one
            return tuple(globs)
        case "up" | "statistics" | "vectors":
            if value not in CHOICES[key]:
                raise ValueError(f"expected {' or '.join(map(repr, CHOICES[key]))}")
            return value
    if not isinstance(value, str):
        raise TypeError("expected the name of a file in this folder")
    path = Path(os.path.normpath(folder / value))
    if not Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder)):
        raise ValueError("leaves the folder; copy the file here")
    if not path.is_file():
        raise ValueError("there is no such file in this folder; copy it here")
    return path


def read_prompts(path: Path) -> tuple[str, ...]:
    """Captions of a text file, one per line; text after a `#` (a length, HumanML3D's tokens) is dropped."""
    lines = source_file.decode(source_file.read_bytes(path), path).splitlines()
    return tuple(line.split("#")[0].strip() for line in lines)


POSES_PER_MOTION = 8
MOST_BONE_VARIATION = 0.25
STILL_METRES, PADDED_SECONDS = 1e-4, 0.5
# Smaller variations of the root's velocity (metres per frame) are not used for the check.
LEAST_STEP_METRES = 0.004
MOST_DISAGREEMENT = 4.0
STATE_STATISTICS = (
    f'write into {MANIFEST} either statistics = "raw", or statistics = "normalised" with mean = "mean.npy" and std = '
    '"std.npy", copies of the files that the model was trained with'
)


def some_poses(
    sequences: Sequence[Float32[np.ndarray, "_frames joints 3"]],
) -> Float32[np.ndarray, "motions poses joints 3"]:
    """A few poses of each motion, evenly spaced."""
    share = np.linspace(0, 1, POSES_PER_MOTION)
    return np.stack([each[np.rint(share * (len(each) - 1)).astype(np.int64)] for each in sequences])


def _variation(bones: Float[np.ndarray, "*batch poses bones"]) -> float:
    """Median over the bones of std ÷ mean of a bone's length; 0 for a rigid body."""
    return float(np.median(bones.std(axis=-2) / np.maximum(bones.mean(axis=-2), 1e-9)))


def body_faults(name: str, motions: Sequence[SampleMotion]) -> dict[int, str]:
    """A message for each motion whose body is not of a person's size.

    Raises `SampleFolderError` if the bones of the others do not keep their lengths.
    """
    bones = body_frame.bone_lengths(some_poses([motion.positions for motion in motions]))
    sizes = np.median(bones.sum(axis=-1), axis=1).tolist()
    faults = {index: _size_message(metres) for index, metres in enumerate(sizes) if not body_frame.is_plausible(metres)}
    kept = np.delete(bones, list(faults), axis=0)
    if len(kept) and (variation := _variation(kept)) > MOST_BONE_VARIATION:
        raise SampleFolderError(
            f"--samples {name}: the bones' lengths vary by {100 * variation:.0f} % within a motion, so these are no "
            "positions of the 22 SMPL (or 21 KIT) joints in their order (docs/samples.md)"
        )
    return faults


def _size_message(metres: float) -> str:
    units = {**body_frame.UNITS, "KIT-ML's unit": humanml3d.KIT.unit_metres}
    name = min(units, key=lambda name: abs(np.log(max(metres * units[name], 1e-30) / body_frame.TYPICAL_HEIGHT_METRES)))
    in_unit, advice = metres * units[name], "no usual unit explains it"
    if body_frame.is_plausible(in_unit):
        advice = f"in {name} it would be {in_unit:.2f} m: unit_metres = {units[name]:.6g} in {MANIFEST}"
    return f"a body measures {metres:.3g} m from ankle to head, people {body_frame.TYPICAL_HEIGHT_METRES} m; {advice}"


def upright(motions: Sequence[SampleMotion], up: str) -> tuple[list[SampleMotion], str]:
    """Motions rotated so that most bodies stand along +y, with a remark; `up` is the axis, or "" to infer it.

    All motions are rotated alike, since a lying body does not show the axes. Rotated ones lose their pose vectors and
    KIT joints, which have y up by definition.
    """
    if motions and not up:
        poses = some_poses([motion.positions for motion in motions]).reshape(-1, SMPL22.num_joints, 3)
        up = body_frame.infer_up(SMPL22, poses, ("y", "z", "-y"))
    if up in ("", "y"):
        return list(motions), ""
    positions = (body_frame.to_y_up(motion.positions, up).astype(np.float32) for motion in motions)
    turned = [
        replace(motion, positions=own, vectors=None, kit_joints=None)
        for motion, own in zip(motions, positions, strict=True)
    ]
    return turned, body_frame.log_lines(up)[0]


def padding_remark(motions: Sequence[SampleMotion]) -> str:
    """A remark if motions end in a pose that is frozen for half a second or more, which may be padding; else empty."""
    frozen = []
    for motion in motions:
        steps = np.abs(np.diff(motion.positions - motion.positions[:, :1], axis=0)).max(axis=(1, 2))
        moved = np.flatnonzero(steps > STILL_METRES)
        seconds = (len(steps) - 1 - moved[-1]) / float(motion.fps) if len(moved) else 0.0
        if seconds >= PADDED_SECONDS:
            frozen.append(seconds)
    if not frozen:
        return ""
    return (
        f"{counted(len(frozen), 'motion')} with a frozen pose at the end ({np.median(frozen):.1f} s in the median): if "
        "that is padding, state their num_frames in a CSV beside them"
    )


def published_layout(num_values: int) -> humanml3d.Layout:
    """HumanML3D's layout for 263 numbers, KIT-ML's for 251."""
    return next(layout for layout in humanml3d.LAYOUTS.values() if layout.num_values == num_values)


def check_vectors(
    name: str, stored: Float[np.ndarray, "rows numbers"], restored: Float[np.ndarray, "rows numbers"], statistics: str
) -> None:
    """Raise `SampleFolderError` if the stated statistics contradict pose vectors as stored and as restored.

    Raw vectors that are said to be normalised, or the reverse, make no body. Statistics of another convention (the
    published evaluators weight root numbers 25-fold) make the root's own velocity disagree with its joint's.
    """
    what = f"--samples {name}: {stored.shape[1]}-number pose vectors are said to be {statistics}, but"

    def makes_body(vectors: Float[np.ndarray, "rows numbers"]) -> bool:
        bones = body_frame.bone_lengths(_local_joints(vectors))
        size = float(np.median(bones.sum(axis=-1)))
        return body_frame.is_plausible(size) and _variation(bones) <= MOST_BONE_VARIATION

    if statistics == NORMALISED and makes_body(stored):
        raise SampleFolderError(f"{what} as they are they make a body, so they look raw; {STATE_STATISTICS}")
    if not makes_body(restored):
        raise SampleFolderError(
            f"{what} they make no body: they are of another dataset or convention; {STATE_STATISTICS}"
        )
    layout = published_layout(stored.shape[1])
    slices = layout_of(layout.skeleton.num_joints).vector
    first = slices.joint_velocities.start
    own, joint = (
        float(np.linalg.norm(restored[:, columns].std(axis=0, dtype=np.float64))) * layout.unit_metres
        for columns in (slices.root_velocity, [first, first + 2])
    )
    if max(own, joint) > LEAST_STEP_METRES and not joint / MOST_DISAGREEMENT < own < joint * MOST_DISAGREEMENT:
        raise SampleFolderError(
            f"{what} the root's own velocity varies {own:.2g} m a frame, and its joint's {joint:.2g}. The published "
            "evaluators' statistics weight root numbers 25-fold, those of Mean.npy and Std.npy do not: normalise and "
            "restore with the same files"
        )


def _local_joints(vectors: Float[np.ndarray, "rows numbers"]) -> Float32[np.ndarray, "rows 22 3"]:
    """Poses in metres, without their path."""
    layout = published_layout(vectors.shape[1])
    slices = layout_of(layout.skeleton.num_joints).vector
    joints = np.zeros((len(vectors), layout.skeleton.num_joints, 3), dtype=np.float32)
    joints[:, 1:] = vectors[:, slices.joint_positions].reshape(len(vectors), -1, 3)
    joints[:, 0, 1] = vectors[:, slices.root_height][:, 0]
    return np.asarray(joint_map(layout.skeleton, SMPL22.name).weights @ joints * np.float32(layout.unit_metres))


ARRAY_SUFFIXES = (".npy", ".npz")
STATISTICS_NAMES = frozenset({"mean", "std"})
# What published code writes beside its samples: real motions, and copies with corrected feet.
COPIES = ("*_gt.*", "*_ref.*", "*_ik.*")
# Other formats are self-contained; these may be normalised, and state no framerate.
PLAIN_ARRAYS = frozenset({"joints-npy", "pose-vectors"})
# Problems of a scan that are reported differently here, or are none.
HANDLED_HERE = ("caption-without-motion", "empty-folder", "unknown-format")
MOST_SIDECAR_BYTES = 1 << 16
CHECKED_ROWS = 20_000


@dataclass(frozen=True)
class SampleOptions:
    """Options for all folders of samples; `fps` and `up` (x, y or z) hold where nothing in a folder states them.

    `keep_published` keeps pose vectors and KIT-ML's 21 joints beside the 22 joints, for evaluators that read these: up
    to five times the memory.
    """

    fps: Fraction | None = None
    up: str = ""
    keep_published: bool = False


def read_sample_folder(
    name: str, source: Path, options: SampleOptions | None = None, on_progress: OnProgress = ignore
) -> SampleFolder:
    """Read every motion of a folder, or of one file.

    Motions that cannot be read, whose framerate is not known, that hold NaN or are no human bodies are in `left_out`.
    Raises `SampleFolderError` without any other motion, for missing metadata (statistics of pose vectors), or for
    motions that are no bodies, and `FormatError` for a broken `samples.toml`.
    """
    reader = _Reader(name, list_samples(name, source), options or SampleOptions())
    listing, left_out = reader.listing, list(reader.listing.problems)

    def motions_of(files: Sequence[Path | SourceItem]) -> Iterator[SampleMotion]:
        for file in files:
            for motion in reader.motions(file):
                if isinstance(motion, SampleMotion):
                    yield motion
                else:
                    left_out.append(motion)
            work.advance()

    with task(on_progress, f"reading {name}", len(listing.arrays) + len(listing.items)) as work:
        # Other formats than plain arrays are turned when they are read.
        arrays, remark = upright(list(motions_of(listing.arrays)), reader.up)
        motions = [*arrays, *motions_of(listing.items)]
    if not motions:
        raise SampleFolderError(f"--samples {name}: no motion can be read: {left_out_line(left_out, 0)}")
    for rows in reader.vectors.values():
        stored = np.concatenate(rows)
        stored = stored[:: -(-len(stored) // CHECKED_ROWS)]
        check_vectors(name, stored, reader.restored(stored), listing.manifest.statistics)
    faults = body_faults(name, motions)
    left_out += [
        FormatError(f"{motions[index].sequence_id}: {message}", path=motions[index].path, reason="body-size")
        for index, message in faults.items()
    ]
    motions = [motion for index, motion in enumerate(motions) if index not in faults]
    if not motions:
        raise SampleFolderError(f"--samples {name}: no motion is a body: {left_out_line(left_out, 0)}")
    padded = f"of {counted(reader.num_trimmed, 'motion')} the last frames, all zeros, were dropped"
    remarks = (*listing.remarks, padded if reader.num_trimmed else "", remark, padding_remark(motions))
    return SampleFolder.of(name, motions, left_out, list(filter(None, remarks)))


@dataclass(frozen=True)
class Listing:
    """The files of one folder of samples: `arrays` are read here, `items` by motionkit's formats.

    `rows` are the CSV files' rows by file; `problems` are files that cannot be listed or recognised.
    """

    root: Path
    manifest: Manifest
    arrays: Sequence[Path]
    items: Sequence[SourceItem]
    rows: Mapping[Path, annotations.Annotation]
    problems: Sequence[FormatError]
    remarks: Sequence[str]

    def place(self, path: Path) -> str:
        """A motion's id: its file's path relative to the folder, without suffix."""
        return path.relative_to(self.root).with_suffix("").as_posix()


def list_samples(name: str, source: Path) -> Listing:
    """List a folder (or one file) of samples.

    Raises `SampleFolderError` for an empty one, `FormatError` for a broken manifest.
    """
    if not source.exists():
        raise SampleFolderError(f"--samples {name}: there is no folder {str(source)!r}")
    root = (source if source.is_dir() else source.parent).resolve()
    manifest = read_manifest(root)
    scanned = scan([source], ReadOptions(format=manifest.vectors or "auto"))
    exclude = (() if manifest.files else COPIES) if manifest.exclude is None else manifest.exclude
    dropped: Counter[str] = Counter()

    def is_chosen(path: Path) -> bool:
        place = path.relative_to(root)
        if manifest.files and not any(map(place.match, manifest.files)):
            return False
        excluded = next(filter(place.match, exclude), None)
        dropped.update([excluded] if excluded else [])
        return excluded is None

    plain = {item.path for item in scanned.items if item.format in PLAIN_ARRAYS}
    plain |= {*scanned.ignored} if source.is_dir() or scanned.items else {root / source.name}
    arrays = [
        path
        for path in sorted(plain, key=lambda path: (path.parent.parts, path.name))
        if path.suffix.lower() in ARRAY_SUFFIXES and path.stem.lower() not in STATISTICS_NAMES
        if path not in (manifest.mean, manifest.std) and is_chosen(path)
    ]
    items = [item for item in scanned.items if item.format not in PLAIN_ARRAYS and is_chosen(item.path)]
    names = {path.stem for path in arrays}
    if names and all(item.path.stem in names for item in items if not item.key):
        dropped.update(f"*{item.path.suffix} of the same names as the arrays" for item in items if not item.key)
        items = [item for item in items if item.key]
    problems = [problem for problem in scanned.problems if problem.reason not in HANDLED_HERE]
    if not arrays and not items and not problems:
        raise SampleFolderError(
            f"--samples {name}: no motion was found in {str(source)!r}: expected .npy, .npz, .bvh or another format (a "
            ".pkl or .pt can execute code: export its arrays, docs/samples.md)"
            + (f"; {MANIFEST} chooses files" if manifest.files or manifest.exclude else "")
            + "".join(f"; {counted(count, 'file')} {what} left out" for what, count in dropped.items())
        )
    remarks = [f"{counted(each, 'file')} {what} left out (files in {MANIFEST})" for what, each in dropped.items()]
    remarks += [f"{warning.path.name}: {warning.message}" for warning in scanned.warnings]
    paths = [*arrays, *(item.path for item in items)]
    folders = sorted({folder for path in paths for folder in path.parents if folder.is_relative_to(root)})
    # The CSV nearest to a file wins.
    rows = {
        path: row
        for folder in folders
        for table in annotations.tables_in(folder)[0]
        for path, row in table.rows.items()
    }
    absent = [path for path in rows if not os.path.exists(path)]  # noqa: PTH110 (a name may be too long)
    if absent:
        remarks.append(f"{counted(len(absent), 'row')} of the CSV without a file, first {absent[0].name!r}")
    return Listing(root, manifest, arrays, items, rows, problems, remarks)


class _Reader:
    """Reads files of one listing; owns what they share: statistics, prompts, framerates of folders."""

    def __init__(self, name: str, listing: Listing, options: SampleOptions) -> None:
        self.name, self.listing, self.options = name, listing, options
        self.num_trimmed, self.manifest = 0, listing.manifest
        self.vectors: dict[int, list[np.ndarray]] = defaultdict(list)
        # The axis that points up, empty where it is to be inferred.
        self.up = self.manifest.up or self.options.up
        self._prompts = read_prompts(self.manifest.prompts) if self.manifest.prompts else ()
        self._beside = cache(lambda folder: joints_npy.read_manifest(folder / joints_npy.MANIFEST))
        self._statistics = cache(self._load_statistics)

    def motions(self, source: Path | SourceItem) -> Iterator[SampleMotion | FormatError]:
        """The motions of one file with their framerates and texts, and problems of the others."""
        path = source.path if isinstance(source, SourceItem) else source
        try:
            for stored in [source] if isinstance(source, SourceItem) else read_stored(source):
                try:
                    yield self._of_format(stored) if isinstance(stored, SourceItem) else self._of_array(path, stored)
                except FormatError as problem:
                    yield problem
        except FormatError as problem:
            yield problem
        except SkeletonMapError as problem:
            yield FormatError(str(problem), path=path, reason="skeleton")

    def _of_format(self, item: SourceItem) -> SampleMotion:
        options = ReadOptions(fps=self.manifest.fps, unit_metres=self.manifest.unit_metres, up=self.up)
        motion, row = read(item, options), self.listing.rows.get(item.path, {})
        group, num_frames = row.get("group") or published_group(item.path), row.get("num_frames")
        is_kit = self.options.keep_published and motion.skeleton.joint_names == KIT21.joint_names
        return SampleMotion(
            # A folder format names a sequence by its key, not by its file.
            sequence_id=item.key or self.listing.place(item.path),
            positions=map_joints(motion, SMPL22.name)[:num_frames],
            fps=motion.fps,
            caption=motion.captions[0].text if motion.captions else self._prompt(group),
            action=motion.action,
            group=group,
            kit_joints=motion.joint_positions[:num_frames] if is_kit else None,
            path=item.path,
        )

    def _of_array(self, path: Path, stored: StoredMotion) -> SampleMotion:
        row, beside = self.listing.rows.get(path, {}), self._beside(path.parent)
        numbers = self._trimmed(stored.numbers[: row.get("num_frames")], path)
        numbers = npy.checked_numbers(numbers, path, "" if stored.index is None else f"motion {stored.index}")
        layout = published_layout(numbers.shape[1]) if numbers.ndim == 2 else None
        fps = self.manifest.fps or row.get("fps") or stored.fps or beside.fps or self.options.fps
        fps = fps or (layout.fps if layout else None)
        if fps is None:
            message = f"nothing says its framerate; write fps = 20 (or what it is) into {self.listing.root / MANIFEST}"
            message += " (HumanML3D's models have 20, KIT-ML's 12.5), or give samples --fps, eval --samples-fps"
            raise FormatError(message, path=path, reason="framerate")
        if layout:
            self.vectors[layout.num_values].append(numbers)
            vectors = self.restored(numbers)
            positions = humanml3d.recover_positions(vectors, layout.skeleton.num_joints)
        else:
            # The hands of SMPL's 24 and SMPL-H's 52 joints are dropped.
            vectors, positions = None, numbers[:, : SMPL22.num_joints]
        unit = self.manifest.unit_metres or (layout.unit_metres if layout else beside.unit_metres)
        positions = positions if unit == 1.0 else positions * np.float32(unit)
        kit_joints = positions if positions.shape[1] == KIT21.num_joints else None
        if kit_joints is not None:
            positions = map_joints(Motion(positions, KIT21, TimeGrid(fps, len(positions))), SMPL22.name)
        group = row.get("group") or stored.group or published_group(path)
        caption = row["captions"][0].text if "captions" in row else stored.caption
        if not caption and stored.index is None:
            caption = _caption_beside(path)
        return SampleMotion(
            sequence_id=self.listing.place(path) + ("" if stored.index is None else f"/{stored.index:04d}"),
            positions=positions,
            fps=fps,
            caption=caption or self._prompt(group),
            action=row.get("action") or stored.action,
            group=group,
            vectors=vectors if self.options.keep_published else None,
            kit_joints=kit_joints if self.options.keep_published else None,
            path=path,
        )

    def _trimmed(self, numbers: np.ndarray, path: Path) -> np.ndarray:
        """Drop last frames that are all zeros, which are padding."""
        if numbers[-1].any():
            return numbers
        kept = np.flatnonzero(numbers.reshape(len(numbers), -1).any(axis=1))
        if not len(kept):
            raise FormatError("all numbers are 0", path=path, reason="no-frames")
        self.num_trimmed += 1
        return numbers[: kept[-1] + 1]

    def restored(self, numbers: np.ndarray) -> Float32[np.ndarray, "frames numbers"]:
        """Pose vectors in their own units."""
        statistics = self._statistics(numbers.shape[1])
        return numbers if statistics is None else statistics.restore(numbers)

    def _load_statistics(self, width: int) -> Statistics | None:
        """The statistics that the manifest names; None for raw vectors. Raises `SampleFolderError`."""
        what = f"--samples {self.name}: {width}-number pose vectors"
        if not self.manifest.statistics:
            raise SampleFolderError(f"{what}, and nothing says whether they are normalised; {STATE_STATISTICS}")
        files = [path for path in (self.manifest.mean, self.manifest.std) if path is not None]
        try:
            numbers = [npy.read_npy(path, source_file.read_bytes(path), (width,)).astype(np.float64) for path in files]
            return Statistics(*numbers) if numbers else None
        except (FormatError, ValueError) as problem:
            raise SampleFolderError(f"{what}: {problem}") from None

    def _prompt(self, group: str) -> str:
        """The caption of a group from the prompts, empty for none."""
        line = whole_number(group)
        return "" if line is None or line >= len(self._prompts) else self._prompts[line]


def published_group(path: Path) -> str:
    """The prompt's number in a file name as MDM and MoMask write it (sample3_repeat0_len196); else empty."""
    match = re.fullmatch(r"sample_?(\d+)_rep(eat)?_?\d+(_len\d+)?(_ik)?", path.stem)
    return match[1] if match else ""


def _caption_beside(path: Path) -> str:
    """The first caption in a text file of the same name, as MLD's demo writes it; empty where there is none."""
    beside = path.with_suffix(".txt")
    with suppress(FormatError, OSError, IndexError):
        return texts.read_texts(beside)[0].text if beside.stat().st_size <= MOST_SIDECAR_BYTES else ""
    return ""
