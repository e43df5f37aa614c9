"""Clips as they come: found in files, folders and stores, read whole, and written again in their own form."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64

from motionkit.completing import vectors_npy
from motionkit.completing.holes import read_with_holes
from motionkit.completion import Completion
from motionkit.errors import FormatError, StoreError, UsageError
from motionkit.formats import registry
from motionkit.formats.arrays.joints_npy import write_joints_npy
from motionkit.formats.arrays.npz import write_npz
from motionkit.formats.bvh.document import BvhDocument, ChannelLines, read_document
from motionkit.formats.bvh.motion import write_bvh
from motionkit.formats.items import ReadOptions, SourceItem
from motionkit.formats.pose_folders.humanml3d import VECTORS_FOLDER
from motionkit.motion import Motion
from motionkit.motionfield import Poses
from motionkit.skeleton import STANDARD_SKELETONS

FRAMES_AT_ONCE = 2048
MADE = ".completed"

Progress = Callable[[int], None]


@dataclass(frozen=True, eq=False)
class Clip:
    """One clip to complete: its motion, which of its frames are whole, and its form.

    `write` writes a completed motion of it to a path; what cannot be written as it came goes to another `suffix`.
    `uneven_seconds` are the times of its frames where they are not those of the motion's grid.
    """

    motion: Motion
    seen: Bool[np.ndarray, "frames"]
    suffix: str
    write: Callable[[Completion, Path, Progress], None]
    note: str = ""
    uneven_seconds: Float64[np.ndarray, "frames"] | None = None

    @property
    def seconds(self) -> Float64[np.ndarray, "frames"]:
        """When its frames were."""
        return self.motion.timegrid.seconds() if self.uneven_seconds is None else self.uneven_seconds


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
        document = read_document(item.path, options)
        document = replace(document, motion=replace(document.motion, captions=item.captions))
        return Clip(document.motion, document.seen, ".bvh", lambda *told: write_document(document, *told))
    read = read_with_holes(item, options)
    if item.path.parent.name == VECTORS_FOLDER:
        return Clip(read.motion, read.seen, ".npy", _writing(vectors_npy.write_vectors))
    clip = as_clip(read.motion, read.seen, item.path.suffix.lower(), f"{item.format} cannot be written")
    return replace(clip, uneven_seconds=read.uneven_seconds)


def as_clip(motion: Motion, seen: Bool[np.ndarray, "frames"], suffix: str, why_not: str) -> Clip:
    """A motion with the writer of its file's suffix; else as .bvh where it has rotations, as .npz where it has none."""
    if suffix == ".npy" and motion.skeleton in STANDARD_SKELETONS.values():
        return Clip(motion, seen, ".npy", _writing(write_joints_npy))
    if suffix == ".npz":
        return Clip(motion, seen, ".npz", _writing(write_npz))
    other = ".npz" if motion.local_rotations is None else ".bvh"
    return Clip(motion, seen, other, _writing(WRITERS[other]), f"{why_not}: its result is a {other[1:]} file")


WRITERS: Mapping[str, Callable[[Motion, Path], None]] = {".npz": write_npz, ".bvh": write_bvh}


def as_format(clip: Clip, suffix: str) -> Clip:
    """The same clip, to be written as another format; raises `UsageError` for one that holds no single clip."""
    if clip.suffix == suffix:
        return clip
    if suffix not in WRITERS:
        raise UsageError(f"clips are written as {', '.join(WRITERS)} or as they came, not as {suffix}")
    return replace(clip, suffix=suffix, write=_writing(WRITERS[suffix]), note="")


def _vectors(path: Path, options: ReadOptions) -> Clip:
    motion, seen = vectors_npy.read_vectors(path, options)
    return Clip(motion, seen, ".npy", _writing(vectors_npy.write_vectors))


def _stored(sequence_id: str, store: Path) -> ClipSource:
    from motionkit.store import Store

    def read() -> Clip:
        motion = opened.read(sequence_id)
        return Clip(motion, np.ones(motion.num_frames, bool), ".npz", _writing(write_npz))

    try:
        opened = Store.open(store)
        opened.index_of(sequence_id)
    except StoreError as error:
        raise UsageError(f"{sequence_id} is no file, and as the id of a stored sequence: {error}") from None
    return ClipSource(sequence_id, Path(sequence_id.replace("/", "_").lstrip(".") or "clip"), read)


def _writing(write: Callable[[Motion, Path], None]) -> Callable[[Completion, Path, Progress], None]:
    """A writer that needs the whole motion at once."""

    def whole(completion: Completion, path: Path, progress: Progress) -> None:
        made = completion.motion(0, completion.grid.num_frames).annotated_like(completion.motion_given)
        progress(made.num_frames)
        write(made.logged(completed_line(completion)), path)

    return whole


def completed_line(completion: Completion) -> str:
    """The operation log's line of a completed motion."""
    given, fps = completion.motion_given, completion.grid.fps
    made = completion.grid.num_frames - len(completion.given_rows)
    return (
        f"complete {given.num_frames} frames at {given.fps} fps -> {completion.grid.num_frames} at {fps}, {made} made"
    )


def write_document(document: BvhDocument, completion: Completion, path: Path, progress: Progress) -> None:
    """Write a completed BVH file piece by piece, given frames as the lines that they were."""
    num_frames, known = completion.grid.num_frames, completion.known_frames
    lines = ChannelLines(document, known)
    # What comes before the first known frame goes backwards from it, so it has to be in the first piece.
    first_known = int(np.searchsorted(completion.grid.seconds(), document.motion.timegrid.seconds()[known[0]] - 1e-9))
    numbers = dict(zip(completion.given_rows.tolist(), completion.given_frames.tolist(), strict=True))
    with path.open("wb") as file:
        file.write(document.heading(num_frames, Fraction(completion.grid.fps)))
        start = 0
        while start < num_frames:
            stop = min(num_frames, max(start + FRAMES_AT_ONCE, first_known + 1 if start == 0 else 0))
            made = completion.motion(start, stop)
            given = [numbers.get(row) for row in range(start, stop)]
            for line in lines.lines(completion.seconds(start, stop), Poses.of(made), given):
                file.write(line + b"\n")
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
