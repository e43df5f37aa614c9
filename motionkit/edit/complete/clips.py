"""Clips from files, folders and stores, and writing them in their own format."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np

from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion
from motionkit.core.shapes import Bool, Float64, Int64
from motionkit.core.skeleton import STANDARD_SKELETONS, Skeleton
from motionkit.core.timegrid import TimeGrid
from motionkit.fields.completion import Completion
from motionkit.fields.motion_field import Observation, Poses
from motionkit.fields.rig import on_bones
from motionkit.io import pose_vectors
from motionkit.io.bvh.document import BvhDocument
from motionkit.io.bvh.writing import ChannelLines, check_writable
from motionkit.io.npz import write_npz
from motionkit.io.reading import read_document
from motionkit.io.registry import FileHead, ReadOptions, SourceItem, writer_of
from motionkit.store.named_motions.holes import ReadClip, read_with_holes, write_vectors
from motionkit.store.named_motions.reading import FoundMotion, Readers, find_motions

Progress = Callable[[int], None]


@dataclass(frozen=True, eq=False)
class Clip:
    """One clip to complete: its frames, a mask of valid ones, and its format.

    `poses` returns frames by index, `observe` an observation of masked frames, `label` copies the clip's name, captions
    and origin to a motion. `write` writes a completed motion to a path; `suffix` is that of the output if the input's
    format cannot be written. `uneven_seconds` are the times of its frames if they are not on a grid.
    """

    timegrid: TimeGrid
    skeleton: Skeleton
    seen: Bool[np.ndarray, "frames"]
    poses: Callable[[Int64[np.ndarray, "rows"]], Poses]
    observe: Callable[[Bool[np.ndarray, "frames"]], Observation]
    label: Callable[[Motion], Motion]
    suffix: str
    write: Callable[[Completion, Path, Progress], None]
    note: str = ""
    uneven_seconds: Float64[np.ndarray, "frames"] | None = None

    @property
    def seconds(self) -> Float64[np.ndarray, "frames"]:
        """Times of its frames."""
        return self.timegrid.seconds() if self.uneven_seconds is None else self.uneven_seconds


ClipSource = FoundMotion[Clip]


def find_clips(names: Sequence[str], options: ReadOptions, store: Path) -> tuple[list[ClipSource], list[FormatError]]:
    """The clips of these names, without outputs of `complete` and `plant`, and problems of others.

    Raises `UsageError` for an unknown name.
    """
    readers = Readers(partial(_read, options=options), clip_of_motion)
    found, problems = find_motions(names, replace(options, skip_derived=True), store, readers)
    return found, problems


def _read(item: SourceItem, options: ReadOptions) -> Clip:
    document = read_document(item, options)
    if document is not None:
        return clip_of_document(document)
    read = read_with_holes(item, options)
    if pose_vectors.accepts(FileHead(item.path)):
        return _in_memory(read, ".npy", write_vectors)
    return _as_it_came(read, item)


def _as_it_came(read: ReadClip, item: SourceItem) -> Clip:
    """Arrays stay arrays; other motions become .bvh if they have rotations, else .npz."""
    suffix, why_not = item.path.suffix.lower(), f"{item.format} cannot be written"
    if item.format == "npz" or (suffix == ".npy" and read.motion.skeleton in STANDARD_SKELETONS.values()):
        return _in_memory(read, suffix, writer_of(suffix))
    other = ".npz" if read.motion.local_rotations is None else ".bvh"
    return _in_memory(read, other, writer_of(other), f"{why_not}: its result is a {other[1:]} file")


def clip_of_document(document: BvhDocument) -> Clip:
    """A BVH file as a clip, with its frames in memory. Raises `FormatError` as `check_writable`."""
    check_writable(document)
    poses = document.poses(np.arange(document.num_frames))

    def observe(observed: Bool[np.ndarray, "frames"]) -> Observation:
        return Observation(document.timegrid.seconds()[observed], poses.rows(observed), document.skeleton)

    return Clip(
        document.timegrid,
        document.skeleton,
        document.seen,
        poses.rows,
        observe,
        document.annotated,
        ".bvh",
        lambda completion, path, progress: write_document(document, completion, path, progress),
    )


def _in_memory(read: ReadClip, suffix: str, write: Callable[[Motion, Path], None], note: str = "") -> Clip:
    motion, uneven = read.motion, read.uneven_seconds

    def observe(observed: Bool[np.ndarray, "frames"]) -> Observation:
        known = Observation.of(motion, observed)
        return known if uneven is None else replace(known, times_seconds=uneven[observed])

    def label(made: Motion) -> Motion:
        return made.annotated_like(motion)

    return Clip(
        motion.timegrid,
        motion.skeleton,
        read.seen,
        Poses.of(motion).rows,
        observe,
        label,
        suffix,
        _writing(write, motion.timegrid, label),
        note,
        uneven,
    )


def as_format(clip: Clip, suffix: str) -> Clip:
    """The same clip with another output format, by its suffix; raises `UsageError` for one that cannot be written."""
    if clip.suffix == suffix:
        return clip
    return replace(clip, suffix=suffix, write=_writing(writer_of(suffix), clip.timegrid, clip.label), note="")


def clip_of_motion(motion: Motion) -> Clip:
    """A motion in memory as a clip."""
    return _in_memory(ReadClip.whole(motion), ".npz", write_npz)


def _writing(
    write: Callable[[Motion, Path], None], source: TimeGrid, label: Callable[[Motion], Motion]
) -> Callable[[Completion, Path, Progress], None]:
    """A writer for whole motions."""

    def whole(completion: Completion, path: Path, progress: Progress) -> None:
        made = completion.motion(0, completion.grid.num_frames)
        progress(made.num_frames)
        write(label(made).logged(completed_line(completion, source)), path)

    return whole


def completed_line(completion: Completion, source: TimeGrid) -> str:
    """The operation log's line for a motion completed from frames on the grid `source`."""
    if completion.line:
        return completion.line
    grid, made = completion.grid, completion.grid.num_frames - len(completion.given_rows)
    return f"complete {source.num_frames} frames at {source.fps} fps -> {grid.num_frames} at {grid.fps}, {made} made"


def write_document(document: BvhDocument, completion: Completion, path: Path, progress: Progress) -> None:
    """Write a completed BVH file; given frames keep their original lines.

    Fields without rotations are converted to rotations of the file's bones.
    """
    completion = replace(completion, field=on_bones(completion.field, completion.observation))
    grid, known = completion.grid, completion.known_frames
    poses = Poses.of(completion.motion(0, grid.num_frames))
    lines = ChannelLines(document, known, completion.observation.times_seconds)
    written = lines.lines(grid.seconds(), poses, completion.given_rows, known[completion.given_poses])
    path.write_bytes(document.heading(grid.num_frames, Fraction(grid.fps)) + b"\n".join((*written, b"")))
    progress(grid.num_frames)
