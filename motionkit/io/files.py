"""Motions of files and folders: `read`, `read_all`, and the sequences that lie at a path."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Literal

import numpy as np

from motionkit.core.errors import FormatError, UsageError
from motionkit.core.files import is_store
from motionkit.core.motion import Motion
from motionkit.core.progress import warn
from motionkit.core.shapes import Bool, Float64
from motionkit.core.skeletons.mapping import read_skeleton_map
from motionkit.core.timegrid import Framerate, parse_fps
from motionkit.io import joints_npy, npy, source_file
from motionkit.io.body_frame import GIVEN_AXES
from motionkit.io.humanml3d import JOINTS_FOLDER, LAYOUTS, VECTORS_FOLDER
from motionkit.io.registry import ReadOptions, SourceItem
from motionkit.io.scan import read as read_item
from motionkit.io.scan import scan

NAMED_IDS = 3
FRAME_ARRAYS = ("joint_positions", "local_rotations", "root_translation")

Seconds = Float64[np.ndarray, "frames"]


def read(
    path: str | Path,
    *,
    sequence: str | None = None,
    format: str = "auto",
    fps: Framerate | None = None,
    unit_metres: int | float | None = None,
    up: str | None = None,
    skeleton_map: str | Path | None = None,
) -> Motion:
    """Read one motion from a file, or from a folder that holds one, at its native framerate.

    The format is found by name and content, or given by its name (docs/formats.md). `fps`, `unit_metres` (length of one
    file unit) and `up` (the axis "x", "y" or "z") replace what the file says or the motion shows; `skeleton_map` is a
    TOML table of how its rig becomes the 22 joints. Captions, action and licence come from an annotation table beside
    the file. Of a folder, `sequence` chooses one by its id or the end of it.

    Raises `FormatError` for a file that cannot be read, `UsageError` for a path that does not exist, and for a folder
    of several motions of which none is chosen.

    >>> mk.read("walk.bvh")
    Motion('captures/walk', 240 frames at 60 fps = 4.00 s, smpl (22 joints), rotations, 1 caption)
    >>> mk.read("takes", sequence="jump").fps
    Fraction(30, 1)
    """
    options = read_options(format, fps, unit_metres, up, skeleton_map)
    path = existing_path(path)
    items, problems = _items_at(path, options)
    if sequence is not None:
        chosen = [item for item in items if item.sequence_id == sequence or item.sequence_id.endswith(f"/{sequence}")]
        if not chosen and items:
            raise UsageError(f"{path} holds no motion {sequence!r}: {_ids(items)}")
        items = chosen
    if not items:
        raise problems[0]
    if len(items) > 1:
        message = f"{path} holds {len(items):,} motions, {_ids(items)}"
        raise UsageError(f"{message}: read one with sequence={items[0].sequence_id!r}, or all with read_all")
    if path.is_file():
        for problem in problems:
            warn(str(problem))
    return read_item(items[0], options)


def read_all(
    path: str | Path,
    *,
    format: str = "auto",
    fps: Framerate | None = None,
    unit_metres: int | float | None = None,
    up: str | None = None,
    skeleton_map: str | Path | None = None,
    on_error: Literal["stop", "skip"] = "stop",
) -> Iterator[Motion]:
    """Read all motions of a file or folder, one at a time as they are iterated over; options are those of `read`.

    What cannot be read raises `FormatError`, or is left out with a warning where `on_error` is "skip". Raises
    `UsageError` for a path that does not exist.

    >>> [motion.sequence_id for motion in mk.read_all("takes")]
    ['takes/jump', 'takes/walk']
    """
    options = read_options(format, fps, unit_metres, up, skeleton_map)
    items, problems = _items_at(existing_path(path), options)

    def motions() -> Iterator[Motion]:
        for problem in problems:
            if on_error == "stop":
                raise problem
            warn(str(problem))
        for item in items:
            try:
                yield read_item(item, options)
            except FormatError as error:
                if on_error == "stop":
                    raise
                warn(str(error))

    return motions()


def read_options(
    format: str = "auto",
    fps: Framerate | None = None,
    unit_metres: int | float | None = None,
    up: str | None = None,
    skeleton_map: str | Path | None = None,
) -> ReadOptions:
    """Options of readers as people give them in Python; raises `ValueError` for a wrong rate, unit or axis."""
    if unit_metres is not None and not 0 < unit_metres < float("inf"):
        raise ValueError(f"unit_metres is a positive length, not {unit_metres}")
    if up is not None and up not in GIVEN_AXES:
        raise ValueError(f"up is {up!r}, expected the file's axis x, y or z that points up")
    return ReadOptions(
        format=format,
        fps=None if fps is None else parse_fps(fps),
        unit_metres=None if unit_metres is None else float(unit_metres),
        up=up or "",
        skeleton_maps=() if skeleton_map is None else (read_skeleton_map(Path(skeleton_map)),),
    )


def existing_path(path: object) -> Path:
    """The path of a file or folder that exists; raises `UsageError` for one that does not, and for another type."""
    if not isinstance(path, str | PathLike):
        message = f"expected a motion, or the path of its file, not {type(path).__name__}"
        raise UsageError(f"{message}: Motion.from_joints makes a motion of an array")
    existing = Path(path)
    if not existing.exists():
        raise UsageError(f"{existing} does not exist")
    return existing


def sequences_at(path: Path, options: ReadOptions) -> tuple[list[tuple[Path, SourceItem]], list[FormatError]]:
    """The sequences of a file or folder, each with its file's path below the one that was given, and all problems.

    A single file has what annotation tables above it say, and the framerate and captions of the folder of HumanML3D's
    form that it is in. Raises `UsageError` for an unknown format.
    """
    if path.is_dir() and path.name in (JOINTS_FOLDER, VECTORS_FOLDER):
        files = sorted(path.glob("*.npy"))
        if any(map(_of_pose_folder, files)):
            scans = [sequences_at(file, options) for file in files]
            return [each for items, _ in scans for each in items], [each for _, faults in scans for each in faults]
    if (published := _of_pose_folder(path)) is not None:
        return [(path, published)], []
    scanned = scan([path], options)
    if path.is_dir():
        return [(path / item.path.relative_to(item.root), item) for item in scanned.items], list(scanned.problems)
    # A data set around the file may be found, but is not meant.
    items = [item for item in scanned.items if item.path.resolve() == path.resolve()]
    problems = list(scanned.problems)
    if not items and not problems:
        problems = [FormatError("it is no motion, but a part of a folder", path=path, reason="part")]
    return [(path, item) for item in items], problems


def _of_pose_folder(path: Path) -> SourceItem | None:
    """A file in a folder of HumanML3D's form, whose place says its framerate and captions; None for any other path."""
    in_place = path.suffix.lower() == ".npy" and path.parent.name in (JOINTS_FOLDER, VECTORS_FOLDER)
    if not in_place or (path.parent / joints_npy.MANIFEST).is_file():
        return None
    shape = npy.peek_shape(path)
    for layout in LAYOUTS.values():
        if shape is not None and shape[1:] in ((layout.skeleton.num_joints, 3), (layout.num_values,)):
            path = path.resolve()
            return SourceItem(layout.name, path, path.parents[1], sequence_id=path.stem, key=path.stem)
    return None


def _items_at(path: Path, options: ReadOptions) -> tuple[list[SourceItem], list[FormatError]]:
    if is_store(path):
        raise UsageError(f"{path} is a store: Store.open({str(path)!r}) reads it")
    sequences, problems = sequences_at(path, options)
    return [item for _, item in sequences], problems


def _ids(items: Sequence[SourceItem]) -> str:
    more = " …" if len(items) > NAMED_IDS else ""
    return ", ".join(item.sequence_id for item in items[:NAMED_IDS]) + more


# Motions with missing frames


def read_with_missing(
    item: SourceItem, options: ReadOptions
) -> tuple[Motion, Bool[np.ndarray, "frames"], Seconds | None]:
    """Read a motion, a mask of its valid frames, and the times of the frames where they are uneven.

    Readers refuse nan, where a tracker lost the body, and uneven time stamps, where a camera dropped frames, as a
    corpus must not contain them. Here a missing frame repeats the last valid one. Only .npz and .npy arrays may have
    missing frames, only .npz uneven times, which must ascend. Raises `FormatError` as `io.scan.read` does, and if no
    frame is valid.
    """
    try:
        motion, uneven_seconds = _read_timed(item, options)
    except FormatError as error:
        if error.reason != "nan" or item.path.suffix.lower() not in (".npz", ".npy") or item.key:
            raise
        motion, uneven_seconds = _read_timed(item, replace(options, fill_missing=True))
        valid = _valid_frames(item.path)
        return motion.logged(f"{int((~valid).sum())} frames hold nan: not observed"), valid, uneven_seconds
    return motion, np.ones(motion.num_frames, bool), uneven_seconds


def _read_timed(item: SourceItem, options: ReadOptions) -> tuple[Motion, Seconds | None]:
    try:
        return read_item(item, options), None
    except FormatError as error:
        if error.reason != "frame-time" or item.format != "npz":
            raise
        seconds = _ascending_seconds(item.path, error)
    # The usual step stands for a framerate where one is needed: how fast the clip is.
    motion = read_item(item, replace(options, fps=parse_fps(float(1 / np.median(np.diff(seconds))))))
    return motion.logged("time stamps are uneven: each frame taken at its own"), seconds


def _ascending_seconds(path: Path, error: FormatError) -> Seconds:
    archive = npy.open_archive(path, source_file.read_bytes(path))
    if "time_seconds" not in archive:
        raise error
    seconds = archive.exact("time_seconds", (None,))
    if len(seconds) < 2 or not np.isfinite(seconds).all():
        raise error
    late = np.diff(seconds) <= 0
    if late.any():
        frame = int(np.argmax(late)) + 1
        before, here = seconds[frame - 1 : frame + 1]
        message = f"is at {here:.6g} s, after a frame at {before:.6g} s: sort frames by time, one of each instant"
        raise FormatError(message, path=path, reason="frame-time", frame=frame)
    return seconds


def _valid_frames(path: Path) -> Bool[np.ndarray, "frames"]:
    data = source_file.read_bytes(path)
    if path.suffix.lower() == ".npy":
        arrays = [npy.parse_npy(path, data, None)]
    else:
        archive = npy.open_archive(path, data)
        arrays = [archive.array(name) for name in FRAME_ARRAYS if name in archive]
    finite = [np.isfinite(array.reshape(len(array), -1)).all(axis=1) for array in arrays]
    return np.asarray(np.logical_and.reduce(finite))
