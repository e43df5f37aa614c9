"""Reading arrays with missing frames: nan where a tracker lost the body, uneven time stamps where a camera dropped.

Readers refuse both, as a corpus must not contain them. Here a missing frame repeats the last valid one.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion
from motionkit.core.shapes import Bool, Float64
from motionkit.core.timegrid import parse_fps
from motionkit.io import npy, source_file
from motionkit.io.registry import ReadOptions, SourceItem
from motionkit.io.scan import read

FRAME_ARRAYS = ("joint_positions", "local_rotations", "root_translation")

Seconds = Float64[np.ndarray, "frames"]


def read_with_missing(
    item: SourceItem, options: ReadOptions
) -> tuple[Motion, Bool[np.ndarray, "frames"], Seconds | None]:
    """Read a motion, a mask of its valid frames, and the times of the frames where they are uneven.

    Only .npz and .npy arrays may have missing frames, only .npz uneven times, which must ascend. Raises `FormatError`
    as `scan.read` does, and if no frame is valid.
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
        return read(item, options), None
    except FormatError as error:
        if error.reason != "frame-time" or item.format != "npz":
            raise
        seconds = _ascending_seconds(item.path, error)
    # The usual step stands for a framerate where one is needed: how fast the clip is.
    motion = read(item, replace(options, fps=parse_fps(float(1 / np.median(np.diff(seconds))))))
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
