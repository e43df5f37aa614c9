"""Reading arrays with missing frames: nan where a tracker lost the body, uneven time stamps where a camera dropped.

Readers refuse both, as a corpus must not contain them. Here a missing frame repeats the last valid one.
"""

import io
import shutil
import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion
from motionkit.core.shapes import Bool, Float64
from motionkit.core.timegrid import parse_fps
from motionkit.io import joints_npy, npy, reading, source_file
from motionkit.io.registry import ReadOptions, SourceItem

FRAME_ARRAYS = ("joint_positions", "local_rotations", "root_translation")

# A motion, a mask of its valid frames, and the times of the frames if these are not even.
WithMissing = tuple[Motion, Bool[np.ndarray, "frames"], Float64[np.ndarray, "frames"] | None]


def read_with_missing(item: SourceItem, options: ReadOptions) -> WithMissing:
    """Read a motion, a mask of its valid frames, and the times of the frames where they are uneven.

    Only .npz and .npy arrays may have missing frames, only .npz uneven times, which must ascend. Raises `FormatError`
    as `reading.read` does, and if no frame is valid.
    """
    try:
        motion, uneven_seconds = _read_timed(item, options)
    except FormatError as error:
        if error.reason != "nan" or item.path.suffix.lower() not in (".npz", ".npy") or item.key:
            raise
        return _read_filled(item, options)
    return motion, np.ones(motion.num_frames, bool), uneven_seconds


def _read_timed(item: SourceItem, options: ReadOptions) -> tuple[Motion, Float64[np.ndarray, "frames"] | None]:
    try:
        return reading.read(item, options), None
    except FormatError as error:
        if error.reason != "frame-time" or item.format != "npz":
            raise
        seconds = _ascending_seconds(item.path, error)
    # The usual step stands for a framerate where one is needed: how fast the clip is.
    motion = reading.read(item, replace(options, fps=parse_fps(float(1 / np.median(np.diff(seconds))))))
    return motion.logged("time stamps are uneven: each frame taken at its own"), seconds


def _ascending_seconds(path: Path, error: FormatError) -> Float64[np.ndarray, "frames"]:
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
        message = (
            f"is at {here:.6g} s, after a frame at {before:.6g} s: sort frames by time and keep one of each instant"
        )
        raise FormatError(message, path=path, reason="frame-time", frame=frame)
    return seconds


def _read_filled(item: SourceItem, options: ReadOptions) -> WithMissing:
    """Read a copy of the file in which missing frames are filled, so that its reader checks all the rest."""
    data = source_file.read_bytes(item.path)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / item.path.name
        if item.path.suffix.lower() == ".npz":
            valid = _copy_npz(item.path, data, copy)
        else:
            filled, valid = filled_frames({"": npy.parse_npy(item.path, data, None)}, item.path)
            np.save(copy, filled[""], allow_pickle=False)
            stated = joints_npy.manifest_of(item.path)
            if stated.is_file():
                shutil.copy(stated, folder)
        motion, uneven_seconds = _read_timed(replace(item, path=copy, root=Path(folder)), options)
    provenance = replace(motion.provenance, source_sha256=source_file.sha256(data))
    line = f"{int((~valid).sum())} frames hold nan: not observed"
    return replace(motion, provenance=provenance).logged(line), valid, uneven_seconds


def _copy_npz(path: Path, data: bytes, copy: Path) -> Bool[np.ndarray, "frames"]:
    archive = npy.open_archive(path, data)
    filled, valid = filled_frames({name: archive.array(name) for name in FRAME_ARRAYS if name in archive}, path)
    with zipfile.ZipFile(copy, "w") as out:
        for info in archive.zipped.infolist():
            content = archive.zipped.read(info)
            if (name := info.filename.removesuffix(".npy")) in filled:
                buffer = io.BytesIO()
                np.save(buffer, filled[name], allow_pickle=False)
                content = buffer.getvalue()
            out.writestr(info.filename, content)
    return valid


def filled_frames(
    arrays: Mapping[str, np.ndarray], path: Path
) -> tuple[dict[str, np.ndarray], Bool[np.ndarray, "frames"]]:
    """Arrays by frame with missing frames filled from the last valid one, and the mask; raises `FormatError`."""
    finite = [np.isfinite(array.reshape(len(array), -1)).all(axis=1) for array in arrays.values()]
    if len({len(each) for each in finite}) > 1:
        raise FormatError("its arrays have different numbers of frames", path=path, reason="channel-count")
    valid = np.logical_and.reduce(finite)
    if not valid.any():
        raise FormatError("every frame holds nan: nothing is observed", path=path, reason="nan")
    source = np.maximum.accumulate(np.where(valid, np.arange(len(valid)), int(np.argmax(valid))))
    return {name: array[source] for name, array in arrays.items()}, valid
