"""Reading a folder of samples: every motion that can be read, and a list of those that cannot."""

import os
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np

from eval.sample_folder import bodies
from eval.sample_folder.arrays import StoredMotion, read_stored
from eval.sample_folder.folder import SampleFolder, SampleFolderError, SampleMotion, left_out_line
from eval.sample_folder.manifest import MANIFEST, Manifest, read_manifest, read_prompts
from motionkit.core.errors import FormatError
from motionkit.core.files import whole_number
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32
from motionkit.core.skeleton import KIT21, SMPL22
from motionkit.core.skeletons.mapping import SkeletonMapError, map_joints
from motionkit.core.timegrid import TimeGrid
from motionkit.features.statistics import Statistics
from motionkit.io import annotations, humanml3d, joints_npy, npy, source_file, texts
from motionkit.io.registry import ReadOptions, SourceItem
from motionkit.io.scan import read, scan

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
OnRead = Callable[[int, int], None]
"""Called with the number of files read and of all files."""


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
    name: str,
    source: Path,
    options: SampleOptions | None = None,
    on_read: OnRead = lambda done, total: None,
) -> SampleFolder:
    """Read every motion of a folder, or of one file.

    Motions that cannot be read, whose framerate is not known, that hold NaN or are no human bodies are in `left_out`.
    Raises `SampleFolderError` without any other motion, for missing metadata (statistics of pose vectors), or for
    motions that are no bodies, and `FormatError` for a broken `samples.toml`.
    """
    reader = _Reader(name, list_samples(name, source), options or SampleOptions())
    listing, left_out = reader.listing, list(reader.listing.problems)

    def motions_of(files: Sequence[Path | SourceItem], num_before: int) -> Iterator[SampleMotion]:
        for number, file in enumerate(files, start=num_before + 1):
            for motion in reader.motions(file):
                if isinstance(motion, SampleMotion):
                    yield motion
                else:
                    left_out.append(motion)
            on_read(number, len(listing.arrays) + len(listing.items))

    # Other formats than plain arrays are turned when they are read.
    arrays, remark = bodies.upright(list(motions_of(listing.arrays, 0)), reader.up)
    motions = [*arrays, *motions_of(listing.items, len(listing.arrays))]
    if not motions:
        raise SampleFolderError(f"--samples {name}: no motion can be read: {left_out_line(left_out, 0)}")
    reader.check_vectors()
    faults = bodies.body_faults(name, motions)
    for index, message in faults.items():
        motion = motions[index]
        place = listing.place(motion.path)
        which = "" if motion.sequence_id == place else f"motion {motion.sequence_id.removeprefix(f'{place}/')}: "
        left_out.append(FormatError(which + message, path=motion.path, reason="body-size"))
    motions = [motion for index, motion in enumerate(motions) if index not in faults]
    if not motions:
        raise SampleFolderError(f"--samples {name}: no motion is a body: {left_out_line(left_out, 0)}")
    padded = f"of {reader.num_trimmed:,} motions the last frames, all zeros, were dropped"
    remarks = [*listing.remarks, *([padded] if reader.num_trimmed else []), *([remark] if remark else [])]
    return SampleFolder.of(name, motions, left_out, (*remarks, *bodies.padding_remark(motions)))


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
    manifest, scanned = read_manifest(root), scan([source])
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
            + "".join(f"; {count:,} files {what} left out" for what, count in dropped.items())
        )
    remarks = [f"{count:,} files {what} left out (files in {MANIFEST} chooses)" for what, count in dropped.items()]
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
        remarks.append(f"{len(absent):,} rows of the CSV describe files that are not there, first {absent[0].name!r}")
    return Listing(root, manifest, arrays, items, rows, problems, remarks)


@dataclass
class _Reader:
    """Reads files of one listing; owns what they share: statistics, prompts, framerates of folders."""

    name: str
    listing: Listing
    options: SampleOptions
    num_trimmed: int = 0
    vectors: dict[int, list[np.ndarray]] = field(default_factory=lambda: defaultdict(list))

    def __post_init__(self) -> None:
        self.manifest = self.listing.manifest
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

    def check_vectors(self) -> None:
        """Raise `SampleFolderError` if the pose vectors contradict what is said of them."""
        for rows in self.vectors.values():
            stored = np.concatenate(rows)
            stored = stored[:: -(-len(stored) // CHECKED_ROWS)]
            bodies.check_vectors(self.name, stored, self._restored(stored), self.manifest.statistics)

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
        layout = bodies.published_layout(numbers.shape[1]) if numbers.ndim == 2 else None
        fps = self.manifest.fps or row.get("fps") or stored.fps or beside.fps or self.options.fps
        fps = fps or (layout.fps if layout else None)
        if fps is None:
            message = f"nothing says its framerate; write fps = 20 (or what it is) into {self.listing.root / MANIFEST}"
            raise FormatError(f"{message} (HumanML3D's models have 20, KIT-ML's 12.5)", path=path, reason="framerate")
        if layout:
            self.vectors[layout.num_values].append(numbers)
            vectors = self._restored(numbers)
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

    def _restored(self, numbers: np.ndarray) -> Float32[np.ndarray, "frames numbers"]:
        """Pose vectors in their own units."""
        statistics = self._statistics(numbers.shape[1])
        return numbers if statistics is None else statistics.restore(numbers)

    def _load_statistics(self, width: int) -> Statistics | None:
        """The statistics that the manifest names; None for raw vectors. Raises `SampleFolderError`."""
        what = f"--samples {self.name}: {width}-number pose vectors"
        if not self.manifest.statistics:
            raise SampleFolderError(f"{what}, and nothing says whether they are normalised; {bodies.STATE_STATISTICS}")
        files = [path for path in (self.manifest.mean, self.manifest.std) if path is not None]
        try:
            numbers = [npy.read_npy(path, source_file.read_bytes(path), (width,)).astype(np.float64) for path in files]
            return Statistics("humanml3d", *numbers) if numbers else None
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
