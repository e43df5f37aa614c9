"""Reading a folder of samples: every motion that can be read, and a list of those that cannot."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np

from eval.sample_folder.arrays import StoredMotion, read_stored
from eval.sample_folder.bodies import (
    LAYOUT_BY_WIDTH,
    STATE_STATISTICS,
    body_faults,
    check_vectors,
    padding_remark,
    upright,
)
from eval.sample_folder.folder import SampleFolder, SampleFolderError, SampleMotion, left_out_line
from eval.sample_folder.listing import Listing, list_samples
from eval.sample_folder.manifest import MANIFEST, SampleOptions, named_fields, read_prompts
from motionkit.core.errors import FormatError, MotionkitError
from motionkit.core.files import whole_number
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32
from motionkit.core.skeleton import KIT21, SMPL22
from motionkit.core.skeletons.mapping import map_joints
from motionkit.core.timegrid import TimeGrid
from motionkit.features.statistics import Statistics
from motionkit.io import humanml3d, joints_npy, npy, source_file, texts
from motionkit.io.annotations import Annotation
from motionkit.io.npy import MAX_NUMBER
from motionkit.io.registry import ReadOptions, SourceItem
from motionkit.io.scan import read

MOST_SIDECAR_BYTES = 1 << 16
CHECKED_ROWS = 20_000
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
    motions, paths, left_out = list[SampleMotion](), list[Path](), list(listing.problems)
    num_of_arrays = 0
    files: tuple[Path | SourceItem, ...] = (*listing.arrays, *listing.items)
    for number, file in enumerate(files):
        for motion in reader.motions(file):
            if isinstance(motion, FormatError):
                left_out.append(motion)
            else:
                motions.append(motion)
                paths.append(file.path if isinstance(file, SourceItem) else file)
        if number + 1 == len(listing.arrays):
            num_of_arrays = len(motions)
        on_read(number + 1, listing.num_files)
    if not motions:
        raise SampleFolderError(f"--samples {name}: no motion can be read: {left_out_line(left_out, 0)}")
    reader.check_vectors()
    # Other formats than plain arrays are turned when they are read.
    turned, remark = upright(motions[:num_of_arrays], reader.up)
    motions = [*turned, *motions[num_of_arrays:]]
    faults = body_faults(name, motions, up_is_stated=bool(reader.up))
    for index, (reason, message) in sorted(faults.items()):
        # Motions of one file are named by their place in it.
        place, own = listing.place(paths[index]), motions[index].sequence_id
        which = "" if own == place else f"motion {own.removeprefix(f'{place}/')}: "
        left_out.append(FormatError(which + message, path=paths[index], reason=reason))
    motions = [motion for index, motion in enumerate(motions) if index not in faults]
    if not motions:
        raise SampleFolderError(f"--samples {name}: no motion is a body: {left_out_line(left_out, 0)}")
    padded = f"of {reader.num_trimmed:,} motions the last frames, all zeros, were dropped"
    remarks = [*listing.remarks, *([padded] if reader.num_trimmed else []), *([remark] if remark else [])]
    return SampleFolder.of(name, motions, left_out, (*remarks, *padding_remark(motions)))


@dataclass
class _Reader:
    """Reads files of one listing; owns what they share: statistics, prompts, framerates of folders."""

    name: str
    listing: Listing
    options: SampleOptions
    num_trimmed: int = 0
    _vectors: list[np.ndarray] = field(default_factory=list)

    def __post_init__(self) -> None:
        prompts = self.listing.manifest.prompts
        self._prompts = read_prompts(prompts) if prompts else ()
        self._beside = cache(lambda folder: joints_npy.read_manifest(folder / joints_npy.MANIFEST))
        self._statistics = cache(self._load_statistics)

    @property
    def up(self) -> str:
        """The axis that points up, empty where it is to be inferred."""
        return self.listing.manifest.up or self.options.up

    def motions(self, source: Path | SourceItem) -> Iterator[SampleMotion | FormatError]:
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

    def check_vectors(self) -> None:
        """Raise `SampleFolderError` if the pose vectors contradict what is said of them."""
        for width in {rows.shape[1] for rows in self._vectors}:
            stored = np.concatenate([rows for rows in self._vectors if rows.shape[1] == width])
            stored = stored[:: -(-len(stored) // CHECKED_ROWS)].astype(np.float32)
            check_vectors(self.name, stored, self._restored(stored), self.listing.manifest.statistics)

    def _of_format(self, item: SourceItem) -> SampleMotion:
        manifest = self.listing.manifest
        motion = read(item, ReadOptions(fps=manifest.fps, unit_metres=manifest.unit_metres, up=self.up))
        row, named = self.listing.rows.get(item.path, Annotation()), named_fields(item.path, manifest)
        num_frames = row.get("num_frames") or whole_number(named.get("num_frames", "")) or None
        positions = map_joints(motion, SMPL22.name)[:num_frames]
        caption = (motion.captions[0].text if motion.captions else "") or named.get("caption", "")
        group = row.get("group") or named.get("group", "")
        is_kit = self.options.keep_published and motion.skeleton.joint_names == KIT21.joint_names
        return SampleMotion(
            # A folder format names a sequence by its key, not by its file.
            sequence_id=item.key or self.listing.place(item.path),
            positions=positions,
            fps=motion.fps,
            caption=caption or self._prompt(group),
            action=motion.action or named.get("action", ""),
            group=group,
            kit_joints=motion.joint_positions[: len(positions)] if is_kit else None,
        )

    def _of_array(self, path: Path, stored: StoredMotion) -> SampleMotion:
        row, named = self.listing.rows.get(path, Annotation()), named_fields(path, self.listing.manifest)
        num_frames = row.get("num_frames") or whole_number(named.get("num_frames", "")) or None
        numbers = self._trimmed(stored.numbers[:num_frames], path)
        _check_finite(numbers, path, stored.index)
        caption = row["captions"][0].text if "captions" in row else stored.caption
        if not caption and stored.index is None:
            caption = _caption_beside(path)
        group = row.get("group") or stored.group or named.get("group", "")
        fps = self.listing.manifest.fps or row.get("fps") or stored.fps or self._beside(path.parent).fps
        fps = fps or self.options.fps or (LAYOUT_BY_WIDTH[numbers.shape[1]].fps if stored.is_vectors else None)
        if fps is None:
            raise FormatError(
                f"nothing says its framerate; write fps = 20 (or what it is) into {self.listing.root / MANIFEST}, or "
                f"give {self.options.fps_option} 20 (HumanML3D's models have 20, KIT-ML's 12.5)",
                path=path,
                reason="framerate",
            )
        vectors = kit_joints = None
        if stored.is_vectors:
            if not self.listing.manifest.statistics:
                raise SampleFolderError(
                    f"--samples {self.name}: {numbers.shape[1]}-number pose vectors, and nothing says whether they are "
                    f"normalised; {STATE_STATISTICS}"
                )
            self._vectors.append(numbers)
            vectors = self._restored(numbers)
        positions = self._joints(numbers, path) if vectors is None else self._joints_of(vectors)
        if positions.shape[1] == KIT21.num_joints:
            kit_joints = positions
            positions = map_joints(Motion(positions, KIT21, TimeGrid(fps, len(positions))), SMPL22.name)
        return SampleMotion(
            sequence_id=self.listing.place(path) + ("" if stored.index is None else f"/{stored.index:04d}"),
            positions=positions,
            fps=fps,
            caption=caption or named.get("caption", "") or self._prompt(group),
            action=row.get("action") or stored.action or named.get("action", ""),
            group=group,
            vectors=vectors if self.options.keep_published else None,
            kit_joints=kit_joints if self.options.keep_published else None,
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

    def _joints(self, numbers: np.ndarray, path: Path) -> Float32[np.ndarray, "frames joints 3"]:
        # The hands of SMPL's 24 and SMPL-H's 52 joints are dropped.
        positions = numbers[:, : SMPL22.num_joints].astype(np.float32, copy=False)
        unit = self.listing.manifest.unit_metres or self._beside(path.parent).unit_metres
        return positions if unit == 1.0 else positions * np.float32(unit)

    def _joints_of(self, vectors: Float32[np.ndarray, "frames numbers"]) -> Float32[np.ndarray, "frames joints 3"]:
        """Joint positions in metres, in the vectors' own layout."""
        layout = LAYOUT_BY_WIDTH[vectors.shape[1]]
        positions = humanml3d.recover_positions(vectors, layout.skeleton.num_joints)
        unit = self.listing.manifest.unit_metres or layout.unit_metres
        return positions if unit == 1.0 else positions * np.float32(unit)

    def _restored(self, numbers: np.ndarray) -> Float32[np.ndarray, "frames numbers"]:
        """Pose vectors in their own units."""
        statistics = self._statistics(numbers.shape[1])
        return (numbers if statistics is None else statistics.restore(numbers)).astype(np.float32, copy=False)

    def _load_statistics(self, width: int) -> Statistics | None:
        """The statistics that the manifest names; None for raw vectors. Raises `SampleFolderError`."""
        mean, std = self.listing.manifest.mean, self.listing.manifest.std
        if mean is None or std is None:
            return None
        try:
            return Statistics("humanml3d", *(_statistic(path, width) for path in (mean, std)))
        except (FormatError, ValueError) as problem:
            raise SampleFolderError(f"--samples {self.name}: {problem}") from None

    def _prompt(self, group: str) -> str:
        """The caption of a group from the prompts, empty for none."""
        line = whole_number(group)
        return "" if line is None or line >= len(self._prompts) else self._prompts[line]


def _check_finite(numbers: np.ndarray, path: Path, index: int | None) -> None:
    """Raise `FormatError` (`nan`, `range`) for the first frame with a value that is no number of a body."""
    if numbers.dtype == np.float16:
        numbers = numbers.astype(np.float32)  # a million is beyond what float16 can be compared with
    with np.errstate(invalid="ignore"):
        if numbers.max() <= MAX_NUMBER and numbers.min() >= -MAX_NUMBER:
            return
        flat = numbers.reshape(len(numbers), -1).astype(np.float64)
    bad = ~((flat <= MAX_NUMBER) & (flat >= -MAX_NUMBER))
    frame = int(np.flatnonzero(bad.any(axis=1))[0])
    value = flat[frame][bad[frame]][0]
    which = "" if index is None else f"motion {index}: "
    reason = "range" if np.isfinite(value) else "nan"
    raise FormatError(f"{which}{value} where a number of a body was expected", path=path, reason=reason, frame=frame)


def _statistic(path: Path, width: int) -> np.ndarray:
    numbers = npy.read_npy(path, source_file.read_bytes(path), (None,)).astype(np.float64)
    if numbers.size != width:
        raise FormatError(
            f"{numbers.size} numbers for pose vectors of {width}; copy the statistics of the right dataset",
            path=path,
            reason="statistics",
        )
    return numbers


def _caption_beside(path: Path) -> str:
    """The first caption in a text file of the same name, as MLD's demo writes it; empty where there is none."""
    beside = path.with_suffix(".txt")
    if not beside.is_file() or beside.stat().st_size > MOST_SIDECAR_BYTES:
        return ""
    try:
        captions = texts.read_texts(beside)
        return captions[0].text if captions else ""
    except FormatError:
        return ""
