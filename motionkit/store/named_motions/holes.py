"""Clips with missing frames: nan for frames that a tracker lost, uneven time stamps for dropped frames.

Readers refuse both, as a corpus must not contain them. Here they are replaced by the previous valid frame, and
returned with a mask of valid frames and the frames' times. HumanML3D's (263) and KIT-ML's (251) pose vectors are
written in the same form again.
"""

import io
import shutil
import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from motionkit.core.checksums import write_json
from motionkit.core.errors import FormatError, MotionkitError
from motionkit.core.framerate import format_fps, parse_fps
from motionkit.core.motion import Motion
from motionkit.core.shapes import Bool, Float64
from motionkit.features import humanml3d
from motionkit.features.humanml3d import at_origin, facing_forward
from motionkit.io import joints_npy, npy, reading
from motionkit.io.humanml3d import LAYOUTS
from motionkit.io.registry import ReadOptions, SourceItem
from motionkit.io.source import source_file

FRAME_ARRAYS = ("joint_positions", "local_rotations", "root_translation")
NAN = "nan"


@dataclass(frozen=True, eq=False)
class ReadClip:
    """A motion, a mask of its valid frames, and their times if they are not on its grid."""

    motion: Motion
    seen: Bool[np.ndarray, "frames"]
    uneven_seconds: Float64[np.ndarray, "frames"] | None = None

    @staticmethod
    def whole(motion: Motion) -> "ReadClip":
        """A clip without missing frames."""
        return ReadClip(motion, np.ones(motion.num_frames, bool))


def read_with_holes(item: SourceItem, options: ReadOptions) -> ReadClip:
    """Reads a clip with missing frames; raises `FormatError` as `reading.read`, and if no frame is valid.

    Only .npz and .npy arrays may have missing frames, only .npz uneven times, which must ascend.
    """
    try:
        motion, uneven = _read_timed(item, options)
    except FormatError as error:
        if error.reason != NAN or item.path.suffix.lower() not in (".npz", ".npy") or item.key:
            raise
        return _read_filled(item, options)
    return ReadClip(motion, np.ones(motion.num_frames, bool), uneven)


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


def filled_rows(
    arrays: Mapping[str, np.ndarray], path: Path
) -> tuple[dict[str, np.ndarray], Bool[np.ndarray, "frames"]]:
    """Arrays by frame with missing frames filled from the previous valid one, and the mask; raises `FormatError`."""
    finite = [np.isfinite(array.reshape(len(array), -1)).all(axis=1) for array in arrays.values()]
    if len({len(each) for each in finite}) > 1:
        raise FormatError("its arrays have different numbers of frames", path=path, reason="channel-count")
    seen = np.logical_and.reduce(finite)
    if not seen.any():
        raise FormatError("every frame holds nan: nothing is observed", path=path, reason=NAN)
    source = np.maximum.accumulate(np.where(seen, np.arange(len(seen)), int(np.argmax(seen))))
    return {name: array[source] for name, array in arrays.items()}, seen


def _read_filled(item: SourceItem, options: ReadOptions) -> ReadClip:
    data = source_file.read_bytes(item.path)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / item.path.name
        if item.path.suffix.lower() == ".npz":
            seen = _copy_npz(item.path, data, copy)
        else:
            filled, seen = filled_rows({"": npy.parse_npy(item.path, data, None)}, item.path)
            np.save(copy, filled[""], allow_pickle=False)
            stated = joints_npy.manifest_of(item.path)
            if stated.is_file():
                shutil.copy(stated, folder)
        motion, uneven = _read_timed(replace(item, path=copy, root=Path(folder)), options)
    provenance = replace(motion.provenance, source_sha256=source_file.sha256(data))
    lost = f"{int((~seen).sum())} frames hold nan: not observed"
    return ReadClip(replace(motion, provenance=provenance).logged(lost), seen, uneven)


def _copy_npz(path: Path, data: bytes, copy: Path) -> Bool[np.ndarray, "frames"]:
    archive = npy.open_archive(path, data)
    there = [name for name in FRAME_ARRAYS if name in archive]
    filled, seen = filled_rows({name: archive.array(name) for name in there}, path)
    with zipfile.ZipFile(copy, "w") as out:
        for info in archive.zipped.infolist():
            name = info.filename.removesuffix(".npy")
            if name not in filled:
                out.writestr(info.filename, archive.zipped.read(info))
                continue
            buffer = io.BytesIO()
            np.save(buffer, filled[name], allow_pickle=False)
            out.writestr(info.filename, buffer.getvalue())
    return seen


def write_vectors(motion: Motion, path: Path) -> None:
    """Write T − 1 rows for T poses, and the framerate to `motions.json` beside them.

    Rates in the vectors are per frame, so they are those of the motion's framerate. Positions are where the first frame
    is above the origin and faces Z+, as the convention has it; nothing is scaled. Raises `MotionkitError` for one pose,
    and for a folder whose `motions.json` says another framerate.
    """
    layout = next(each for each in LAYOUTS.values() if each.skeleton == motion.skeleton)
    if motion.num_frames < 2:
        raise MotionkitError("pose vectors need at least two poses")
    name = layout.skeleton.name
    positions = facing_forward(at_origin(motion.joint_positions / np.float32(layout.unit_metres)), name)
    stated = {"fps": format_fps(motion.fps), "layout": name, "vectors": humanml3d.CONVENTION}
    manifest = path.parent / joints_npy.MANIFEST
    if joints_npy.read_manifest(manifest).fps not in (None, motion.fps):
        raise MotionkitError(f"{manifest} says another framerate than {motion.fps}: one folder holds one, use --out")
    np.save(path, humanml3d.vectors(positions, name), allow_pickle=False)
    write_json(manifest, stated)
