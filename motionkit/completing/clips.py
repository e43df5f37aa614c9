"""Clips as they come: found in files, folders and stores, and written again in their own form.

BVH files are read and written piece by piece; clips of other forms are held in memory, they and their results.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64, Int64

from motionkit.completing import vectors_npy
from motionkit.completing.holes import ReadClip, read_with_holes
from motionkit.completion import Completion
from motionkit.errors import FormatError, StoreError, UsageError
from motionkit.formats import registry
from motionkit.formats.arrays.joints_npy import write_joints_npy
from motionkit.formats.arrays.npz import write_npz
from motionkit.formats.bvh.channel_lines import ChannelLines
from motionkit.formats.bvh.document import BvhDocument, read_document
from motionkit.formats.bvh.motion import write_bvh
from motionkit.formats.items import ReadOptions, SourceItem
from motionkit.formats.pose_folders.humanml3d import VECTORS_FOLDER
from motionkit.long_observation import LongObservation
from motionkit.motion import Caption, Motion
from motionkit.motionfield import Observation, Observed, Poses
from motionkit.skeleton import STANDARD_SKELETONS, Skeleton
from motionkit.timegrid import TimeGrid

FRAMES_AT_ONCE = 2048
MADE = ".completed"

Progress = Callable[[int], None]


@dataclass(frozen=True, eq=False)
class Clip:
    """One clip to complete: its frames, which of them are whole, and its form.

    `poses` are those of frames by number, `observe` makes an observation of those that a mask marks, `label` gives a
    motion the clip's name, captions and origin. `write` writes a completed motion of it to a path; what cannot be
    written as it came goes to another `suffix`. `uneven_seconds` are the times of its frames where they are not those
    of its grid.
    """

    timegrid: TimeGrid
    skeleton: Skeleton
    seen: Bool[np.ndarray, "frames"]
    poses: Callable[[Int64[np.ndarray, "rows"]], Poses]
    observe: Callable[[Bool[np.ndarray, "frames"]], Observed]
    label: Callable[[Motion], Motion]
    suffix: str
    write: Callable[[Completion, Path, Progress], None]
    note: str = ""
    uneven_seconds: Float64[np.ndarray, "frames"] | None = None

    @property
    def seconds(self) -> Float64[np.ndarray, "frames"]:
        """When its frames were."""
        return self.timegrid.seconds() if self.uneven_seconds is None else self.uneven_seconds


@dataclass(frozen=True)
class ClipSource:
    """Where a clip comes from: `name` for people, `beside` the path that its result goes by, without a suffix."""

    name: str
    beside: Path
    read: Callable[[], Clip]


def find_clips(sources: Sequence[str], options: ReadOptions, store: Path) -> tuple[list[ClipSource], list[FormatError]]:
    """The clips of files and folders, and of a store where no file has that name; and what is wrong with some.

    Raises `UsageError` for a name that is neither.
    """
    found: list[ClipSource] = []
    problems: list[FormatError] = []
    for source in sources:
        path = Path(source)
        if not path.exists():
            found.append(_stored(source, store))
        elif path.is_file() and vectors_npy.accepts(path):
            found.append(ClipSource(source, path.with_suffix(""), partial(_vectors, path, options)))
        else:
            scanned = registry.scan([path], options)
            problems += scanned.problems
            items = [item for item in scanned.items if _is_meant(item, path)]
            if path.is_file() and not items and not scanned.problems:
                problems.append(FormatError("it is no clip, but a part of a folder of clips", path=path, reason="part"))
            found += [_of_item(item, source, path, options) for item in items]
    return found, problems


def _is_meant(item: SourceItem, path: Path) -> bool:
    # Of a folder what was not made here; of a file beside a data set's folders not the data set.
    return item.path.resolve() == path.resolve() if path.is_file() else not item.path.stem.endswith(MADE)


def _of_item(item: SourceItem, source: str, path: Path, options: ReadOptions) -> ClipSource:
    name = source if path.is_file() else str(path / item.path.relative_to(item.root))
    beside = Path(name).with_suffix("")
    return ClipSource(
        f"{name} ({item.key})" if item.key and not path.is_file() else name, beside, lambda: _read(item, options)
    )


def _read(item: SourceItem, options: ReadOptions) -> Clip:
    if options.fps is None and item.fps is not None:
        options = replace(options, fps=item.fps)
    if item.path.suffix.lower() == ".bvh" or item.format == "bvh":
        return clip_of_document(read_document(item.path, options), item.captions)
    read = read_with_holes(item, options)
    if item.path.parent.name == VECTORS_FOLDER:
        return _in_memory(read, ".npy", vectors_npy.write_vectors)
    return _as_it_came(read, item.path.suffix.lower(), f"{item.format} cannot be written")


def _as_it_came(read: ReadClip, suffix: str, why_not: str) -> Clip:
    """A motion with the writer of its file's suffix; else as .bvh where it has rotations, as .npz where it has none."""
    if suffix == ".npy" and read.motion.skeleton in STANDARD_SKELETONS.values():
        return _in_memory(read, ".npy", write_joints_npy)
    if suffix == ".npz":
        return _in_memory(read, ".npz", write_npz)
    other = ".npz" if read.motion.local_rotations is None else ".bvh"
    return _in_memory(read, other, WRITERS[other], f"{why_not}: its result is a {other[1:]} file")


def clip_of_document(document: BvhDocument, captions: tuple[Caption, ...] = ()) -> Clip:
    """A BVH file as a clip: its frames are read when they are asked for."""

    def observe(observed: Bool[np.ndarray, "frames"]) -> Observed:
        frames = np.flatnonzero(observed)
        return LongObservation(
            document.timegrid.seconds()[frames], lambda rows: document.poses(frames[rows]), document.skeleton
        )

    def label(made: Motion) -> Motion:
        return replace(made, sequence_id=document.path.stem, captions=captions, provenance=document.provenance)

    return Clip(
        document.timegrid,
        document.skeleton,
        document.seen,
        document.poses,
        observe,
        label,
        ".bvh",
        lambda completion, path, progress: write_document(document, completion, path, progress),
    )


def _in_memory(read: ReadClip, suffix: str, write: Callable[[Motion, Path], None], note: str = "") -> Clip:
    motion, uneven = read.motion, read.uneven_seconds

    def observe(observed: Bool[np.ndarray, "frames"]) -> Observed:
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


WRITERS: Mapping[str, Callable[[Motion, Path], None]] = {".npz": write_npz, ".bvh": write_bvh}


def as_format(clip: Clip, suffix: str) -> Clip:
    """The same clip, to be written as another format; raises `UsageError` for one that holds no single clip."""
    if clip.suffix == suffix:
        return clip
    if suffix not in WRITERS:
        raise UsageError(f"clips are written as {', '.join(WRITERS)} or as they came, not as {suffix}")
    return replace(clip, suffix=suffix, write=_writing(WRITERS[suffix], clip.timegrid, clip.label), note="")


def _vectors(path: Path, options: ReadOptions) -> Clip:
    motion, seen = vectors_npy.read_vectors(path, options)
    return _in_memory(ReadClip(motion, seen), ".npy", vectors_npy.write_vectors)


def _stored(sequence_id: str, store: Path) -> ClipSource:
    from motionkit.store import Store

    def read() -> Clip:
        motion = opened.read(sequence_id)
        return _in_memory(ReadClip(motion, np.ones(motion.num_frames, bool)), ".npz", write_npz)

    try:
        opened = Store.open(store)
        opened.index_of(sequence_id)
    except StoreError as error:
        raise UsageError(f"{sequence_id} is no file, and as the id of a stored sequence: {error}") from None
    return ClipSource(sequence_id, Path(sequence_id.replace("/", "_").lstrip(".") or "clip"), read)


def _writing(
    write: Callable[[Motion, Path], None], source: TimeGrid, label: Callable[[Motion], Motion]
) -> Callable[[Completion, Path, Progress], None]:
    """A writer that needs the whole motion at once."""

    def whole(completion: Completion, path: Path, progress: Progress) -> None:
        made = completion.motion(0, completion.grid.num_frames)
        progress(made.num_frames)
        write(label(made).logged(completed_line(completion, source)), path)

    return whole


def completed_line(completion: Completion, source: TimeGrid) -> str:
    """The operation log's line of a motion that was completed from frames on the grid `source`."""
    grid, made = completion.grid, completion.grid.num_frames - len(completion.given_rows)
    return f"complete {source.num_frames} frames at {source.fps} fps -> {grid.num_frames} at {grid.fps}, {made} made"


def write_document(document: BvhDocument, completion: Completion, path: Path, progress: Progress) -> None:
    """Write a completed BVH file piece by piece, given frames as the lines that they were."""
    num_frames, known = completion.grid.num_frames, completion.known_frames
    observation = completion.observation
    lines = ChannelLines(document, known, observation.times_seconds)
    # What comes before the first known frame goes backwards from it, so it has to be in the first piece.
    reach_seconds = observation.start_seconds - completion.grid.start_seconds
    first_known = max(0, int(np.ceil((reach_seconds - 1e-9) * float(completion.grid.fps))))
    with path.open("wb") as file:
        file.write(document.heading(num_frames, Fraction(completion.grid.fps)))
        start = 0
        while start < num_frames:
            stop = min(num_frames, max(start + FRAMES_AT_ONCE, first_known + 1 if start == 0 else 0))
            made = completion.motion(start, stop)
            rows, given = completion.given(start, stop)
            written = lines.lines(completion.seconds(start, stop), Poses.of(made), rows, known[given])
            file.write(b"\n".join((*written, b"")))
            progress(stop - start)
            start = stop


def write_whole(clip: Clip, completion: Completion, path: Path, progress: Progress) -> None:
    """Write a completed clip so that its file appears whole or not at all."""
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.tmp{path.suffix}")
    try:
        clip.write(completion, temporary, progress)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
