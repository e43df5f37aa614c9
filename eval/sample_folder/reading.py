"""Reading a folder of samples: every motion that can be read, and a list of those that cannot."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np

from eval.sample_folder.arrays import StoredMotion, read_stored
from eval.sample_folder.bodies import BodyFault, body_faults, check_joints, padding_remark, turn_upright
from eval.sample_folder.folder import Packer, SampleFolder, SampleFolderError, SampleText, left_out_line
from eval.sample_folder.listing import Listing, list_samples
from eval.sample_folder.manifest import MANIFEST, NamedParts, SampleOptions, named_parts, read_prompts
from eval.sample_folder.vectors import JOINTS_BY_WIDTH, check_vectors, load_statistics, positions_of
from eval.text_motion.guo.kind import REACH_FRAMES
from motionkit.core.errors import FormatError, MotionkitError
from motionkit.core.files import whole_number
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32
from motionkit.core.skeleton import KIT21, SMPL22
from motionkit.core.skeletons.mapping import map_joints
from motionkit.core.timegrid import TimeGrid
from motionkit.features.statistics import Statistics
from motionkit.io import joints_npy, texts
from motionkit.io.annotations import Annotation
from motionkit.io.npy import MAX_NUMBER
from motionkit.io.reading import read
from motionkit.io.registry import ReadOptions, SourceItem

MOST_SIDECAR_BYTES = 1 << 16
LOOKED_AT_FILES = 64
OnRead = Callable[[int, int], None]
"""Called with the number of files read and of all files."""


def read_sample_folder(
    name: str,
    source: Path,
    options: SampleOptions | None = None,
    on_read: OnRead = lambda done, total: None,
) -> SampleFolder:
    """Read every motion of a folder, or of one file.

    Motions that cannot be read, whose framerate is not known, that hold NaN or are no human bodies are in `left_out`.
    Raises `SampleFolderError` without any other motion, or for missing metadata (statistics of pose vectors, unit of
    length), and `FormatError` for a broken `samples.toml`.
    """
    listing = list_samples(name, source)
    reader = _Reader(name, listing, options or SampleOptions())
    packer, paths, left_out = Packer(), list[Path](), list(listing.problems)
    array_rows = 0
    files: tuple[Path | SourceItem, ...] = (*listing.arrays, *listing.items)
    for number, file in enumerate(files):
        for found in reader.motions(file):
            if isinstance(found, FormatError):
                left_out.append(found)
            else:
                packer.add(*found)
                paths.append(file.path if isinstance(file, SourceItem) else file)
        if number + 1 == len(listing.arrays):
            array_rows = len(packer)
        on_read(number + 1, listing.num_files)
    if not len(packer):
        raise SampleFolderError(f"--samples {name}: no motion can be read: {left_out_line(left_out, 0)}")
    padded = f"of {reader.num_trimmed:,} motions the last frames, all zeros, were dropped"
    remarks = (*listing.remarks, *([padded] if reader.num_trimmed else []))
    return _checked(packer.finish(name, left_out, remarks), paths, array_rows, listing, reader.up)


def _checked(
    folder: SampleFolder, paths: Sequence[Path], num_of_arrays: int, listing: Listing, up: str
) -> SampleFolder:
    """The folder's human bodies, upright; raises `SampleFolderError` if there are none."""
    end = int(folder.sequences.num_frames[:num_of_arrays].sum())
    starts = folder.sequences.start_row[:num_of_arrays]
    turned = turn_upright(folder.sequences.values[:end], starts, up)
    faults = body_faults(folder, up_is_stated=bool(up))
    if faults:
        folder = _without(folder, faults, paths, listing)
    check_joints(folder)
    remarks = (*folder.remarks, *([turned] if turned else []), *padding_remark(folder))
    if turned:
        # Pose vectors have y up by definition: if bodies had to be rotated, their vectors follow another convention.
        folder = replace(folder, vectors=(), kit_joints=())
    return replace(folder, remarks=remarks)


def _without(
    folder: SampleFolder, faults: Mapping[int, BodyFault], paths: Sequence[Path], listing: Listing
) -> SampleFolder:
    """The folder without the motions that are no bodies, each in `left_out`."""
    problems = []
    for index, fault in sorted(faults.items()):
        # Motions of one file are named by their place in it.
        place, name = listing.place(paths[index]), folder.sequence_ids[index]
        which = "" if name == place else f"motion {name.removeprefix(f'{place}/')}: "
        problems.append(FormatError(which + fault.message, path=paths[index], reason=fault.reason))
    left_out = (*folder.left_out, *problems)
    kept = [index for index in range(folder.num_motions) if index not in faults]
    if not kept:
        raise SampleFolderError(f"--samples {folder.name}: no motion is a body: {left_out_line(left_out, 0)}")
    return replace(folder.select(kept), left_out=left_out)


Vectors = Float32[np.ndarray, "_frames numbers"]
KitJoints = Float32[np.ndarray, "_frames 21 3"]
Read = tuple[Float32[np.ndarray, "frames joints 3"], Fraction, SampleText, Vectors | None, KitJoints | None]


@dataclass
class _Reader:
    """Reads files of one listing; owns what they share: statistics, prompts, framerates of folders."""

    name: str
    listing: Listing
    options: SampleOptions
    _statistics: dict[int, Statistics | None] = field(default_factory=dict)
    num_trimmed: int = 0

    def __post_init__(self) -> None:
        prompts = self.listing.manifest.prompts
        self._prompts = read_prompts(prompts) if prompts else ()
        self._beside = cache(lambda folder: joints_npy.read_manifest(folder / joints_npy.MANIFEST))

    @property
    def up(self) -> str:
        """The axis that points up, empty where it is to be inferred."""
        return self.listing.manifest.up or self.options.up

    def motions(self, source: Path | SourceItem) -> Iterator[Read | FormatError]:
        """The motions of one file with their framerates and texts, and problems of the others."""
        try:
            if isinstance(source, SourceItem):
                yield self._of_format(source)
                return
            for stored in read_stored(source):
                try:
                    yield self._of_array(source, stored)
                except FormatError as problem:
                    yield problem
        except FormatError as problem:
            yield problem
        except SampleFolderError:
            raise
        except MotionkitError as problem:
            path = source.path if isinstance(source, SourceItem) else source
            yield FormatError(str(problem), path=path, reason="skeleton")

    def _of_format(self, item: SourceItem) -> Read:
        manifest = self.listing.manifest
        motion = read(item, ReadOptions(fps=manifest.fps, unit_metres=manifest.unit_metres, up=self.up))
        row = self.listing.rows.get(item.path, Annotation())
        # A folder format names a sequence by its key, not by its file.
        place = item.key or self.listing.place(item.path)
        parts = self._parts(item.path)
        positions = map_joints(motion, SMPL22.name)[: row.get("num_frames") or parts.num_frames]
        caption = motion.captions[0].text if motion.captions else ""
        group = row.get("group") or parts.group
        text = SampleText(place, caption or parts.caption, motion.action or parts.action, group)
        kit_joints = None
        if self.options.keep_published and motion.skeleton.joint_names == KIT21.joint_names:
            kit_joints = motion.joint_positions[: len(positions)]
        return positions, motion.fps, self._with_prompt(text), None, kit_joints

    def _of_array(self, path: Path, stored: StoredMotion) -> Read:
        row = self.listing.rows.get(path, Annotation())
        parts = self._parts(path)
        numbers = self._trimmed(stored.numbers[: row.get("num_frames") or parts.num_frames], path)
        _check_finite(numbers, path, stored.index)
        place = self.listing.place(path) + ("" if stored.index is None else f"/{stored.index:04d}")
        caption = row["captions"][0].text if "captions" in row else stored.caption
        if not caption and stored.index is None:
            caption = _sidecar(path)
        text = SampleText(
            place,
            caption or parts.caption,
            row.get("action") or stored.action or parts.action,
            row.get("group") or stored.group or parts.group,
        )
        fps = self._fps(path, stored, row)
        vectors = self._restored(numbers) if stored.is_vectors else None
        positions = self._joints(numbers, path) if vectors is None else self._joints_of(vectors)
        kit_joints = None
        if positions.shape[1] == KIT21.num_joints:
            kit_joints = positions
            positions = map_joints(Motion(positions, KIT21, TimeGrid(fps, len(positions))), SMPL22.name)
        if not self.options.keep_published:
            vectors = kit_joints = None
        if vectors is not None:
            vectors = np.concatenate((vectors, self._restored(_following(stored, len(numbers)))))
        return positions, fps, self._with_prompt(text), vectors, kit_joints

    def _trimmed(self, numbers: np.ndarray, path: Path) -> np.ndarray:
        """Drop last frames that are all zeros, which are padding."""
        if numbers[-1].any():
            return numbers
        kept = np.flatnonzero(numbers.reshape(len(numbers), -1).any(axis=1))
        if not len(kept):
            raise FormatError("all numbers are 0", path=path, reason="no-frames")
        self.num_trimmed += 1
        return numbers[: kept[-1] + 1]

    def _joints(self, numbers: np.ndarray, path: Path) -> Float32[np.ndarray, "frames joints 3"]:
        # The hands of SMPL's 24 and SMPL-H's 52 joints are dropped.
        positions = numbers[:, : SMPL22.num_joints].astype(np.float32, copy=False)
        unit = self.listing.manifest.unit_metres or self._beside(path.parent).unit_metres
        return positions if unit == 1.0 else positions * np.float32(unit)

    def _restored(self, numbers: np.ndarray) -> Vectors:
        """Pose vectors in their own units."""
        statistics = self._stated(numbers)
        return (numbers if statistics is None else statistics.restore(numbers)).astype(np.float32, copy=False)

    def _joints_of(self, vectors: Vectors) -> Float32[np.ndarray, "frames joints 3"]:
        return positions_of(vectors, self.listing.manifest.unit_metres)

    def _fps(self, path: Path, stored: StoredMotion, row: Annotation) -> Fraction:
        beside = self._beside(path.parent).fps
        fps = self.listing.manifest.fps or row.get("fps") or stored.fps or beside or self.options.fps
        if fps is None and stored.is_vectors:
            fps = JOINTS_BY_WIDTH[stored.numbers.shape[1]].fps
        if fps is None:
            raise FormatError(
                f"nothing says its framerate; write fps = 20 (or what it is) into {self.listing.root / MANIFEST}, or "
                f"give {self.options.fps_option} 20 (HumanML3D's models have 20, KIT-ML's 12.5)",
                path=path,
                reason="framerate",
            )
        return fps

    def _stated(self, vectors: np.ndarray) -> Statistics | None:
        """The stated statistics, checked against a few files. Raises `SampleFolderError`."""
        width = vectors.shape[1]
        if width not in self._statistics:
            try:
                statistics = load_statistics(self.listing.manifest, width)
            except FormatError as problem:
                raise SampleFolderError(f"--samples {self.name}: {problem}") from None
            check_vectors(self.name, self._some_like(vectors), self.listing.manifest, statistics)
            self._statistics[width] = statistics
        return self._statistics[width]

    def _some_like(self, vectors: np.ndarray) -> Float32[np.ndarray, "rows numbers"]:
        """These pose vectors and those of some files, evenly spaced over the folder."""
        arrays = self.listing.arrays
        chosen = np.unique(np.linspace(0, len(arrays) - 1, LOOKED_AT_FILES).astype(int))
        found = [vectors]
        for index in chosen.tolist():
            try:
                motions = read_stored(arrays[index])[:LOOKED_AT_FILES]
            except FormatError:
                continue  # reported when all are read
            alike = [motion.numbers for motion in motions if motion.numbers.shape[1:] == vectors.shape[1:]]
            found += [numbers for numbers in alike if _is_plausible(numbers)]
        return np.concatenate(found).astype(np.float32)

    def _parts(self, path: Path) -> NamedParts:
        parts = named_parts(path.stem, self.listing.manifest)
        if parts is None:
            raise FormatError(f"its name does not fit the pattern of {MANIFEST}", path=path, reason="name")
        return parts

    def _with_prompt(self, text: SampleText) -> SampleText:
        """Add the caption of its group from the prompts, if it has none."""
        group = whole_number(text.group)
        if text.caption or group is None or group >= len(self._prompts):
            return text
        return SampleText(text.sequence_id, self._prompts[group], text.action, text.group)


def _is_plausible(numbers: np.ndarray) -> bool:
    """Whether all values are finite, and plausible for a body."""
    if numbers.dtype == np.float16:
        numbers = numbers.astype(np.float32)  # a million is beyond what float16 can be compared with
    with np.errstate(invalid="ignore", over="ignore"):
        total = numbers.sum(dtype=np.float64)
    return bool(np.isfinite(total) and numbers.max() <= MAX_NUMBER and numbers.min() >= -MAX_NUMBER)


def _check_finite(numbers: np.ndarray, path: Path, index: int | None) -> None:
    """Raise `FormatError` (`nan`, `range`) for the first invalid frame."""
    if _is_plausible(numbers):
        return
    with np.errstate(invalid="ignore"):
        flat = numbers.reshape(len(numbers), -1).astype(np.float64)
    bad = ~((flat <= MAX_NUMBER) & (flat >= -MAX_NUMBER))
    frame = int(np.flatnonzero(bad.any(axis=1))[0])
    value = flat[frame][bad[frame]][0]
    which = "" if index is None else f"motion {index}: "
    reason = "range" if np.isfinite(value) else "nan"
    raise FormatError(f"{which}{value} where a number of a body was expected", path=path, reason=reason, frame=frame)


def _following(stored: StoredMotion, num_frames: int) -> np.ndarray:
    """The few frames after a motion that an evaluator's convolutions may see; none if they are not finite."""
    parts = (stored.numbers[num_frames:], *([] if stored.padding is None else [stored.padding]))
    following = np.concatenate([part[:REACH_FRAMES] for part in parts])[:REACH_FRAMES]
    return following if np.isfinite(following).all() else following[:0]


def _sidecar(path: Path) -> str:
    """The first caption in a text file of the same name, as MLD's demo writes it; empty where there is none."""
    beside = path.with_suffix(".txt")
    if not beside.is_file() or beside.stat().st_size > MOST_SIDECAR_BYTES:
        return ""
    try:
        captions = texts.read_texts(beside)
        return captions[0].text if captions else ""
    except FormatError:
        return ""
