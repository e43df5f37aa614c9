"""Frames that a tracker lost are nan in its arrays: they are read as not observed, and completed like any gap.

Readers refuse nan, for a corpus must not hold any. Here a copy without it is read, each lost frame repeating a whole
one, together with the mask that says which frames are whole.
"""

import io
import shutil
import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from motionkit.errors import FormatError
from motionkit.formats import registry, sourcefile
from motionkit.formats.arrays import npy, npz_archive
from motionkit.formats.arrays.joints_npy import MANIFEST
from motionkit.formats.items import ReadOptions, SourceItem
from motionkit.motion import Motion

FRAME_ARRAYS = ("joint_positions", "local_rotations", "root_translation")
NAN = "nan"


def read_with_holes(item: SourceItem, options: ReadOptions) -> tuple[Motion, Bool[np.ndarray, "frames"]]:
    """A motion and which of its frames are whole; raises `FormatError` as `registry.read`, and where none is whole.

    Only .npz and .npy arrays may have holes.
    """
    try:
        motion = registry.read(item, options)
    except FormatError as error:
        if error.reason != NAN or item.path.suffix.lower() not in (".npz", ".npy") or item.key:
            raise
        return _read_filled(item, options)
    return motion, np.ones(motion.num_frames, bool)


def filled_rows(
    arrays: Mapping[str, np.ndarray], path: Path
) -> tuple[dict[str, np.ndarray], Bool[np.ndarray, "frames"]]:
    """Arrays by frame, lost frames replaced by the whole one before, and which are whole; raises `FormatError`."""
    finite = [np.isfinite(array.reshape(len(array), -1)).all(axis=1) for array in arrays.values()]
    if len({len(each) for each in finite}) > 1:
        raise FormatError("its arrays have different numbers of frames", path=path, reason="channel-count")
    seen = np.logical_and.reduce(finite)
    if not seen.any():
        raise FormatError("every frame holds nan: nothing is observed", path=path, reason=NAN)
    source = np.maximum.accumulate(np.where(seen, np.arange(len(seen)), int(np.argmax(seen))))
    return {name: array[source] for name, array in arrays.items()}, seen


def _read_filled(item: SourceItem, options: ReadOptions) -> tuple[Motion, Bool[np.ndarray, "frames"]]:
    data = sourcefile.read_bytes(item.path)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / item.path.name
        if item.path.suffix.lower() == ".npz":
            seen = _copy_npz(item.path, data, copy)
        else:
            filled, seen = filled_rows({"": npy.parse_npy(item.path, data, None)}, item.path)
            np.save(copy, filled[""], allow_pickle=False)
            if (item.path.parent / MANIFEST).is_file():
                shutil.copy(item.path.parent / MANIFEST, folder)
        motion = registry.read(replace(item, path=copy, root=Path(folder)), options)
    provenance = replace(motion.provenance, source_sha256=sourcefile.sha256(data))
    lost = f"{int((~seen).sum())} frames hold nan: not observed"
    return replace(motion, provenance=provenance).logged(lost), seen


def _copy_npz(path: Path, data: bytes, copy: Path) -> Bool[np.ndarray, "frames"]:
    archive = npz_archive.open_archive(path, data)
    there = [name for name in FRAME_ARRAYS if name in archive]
    filled, seen = filled_rows({name: npz_archive.read_plain(archive, name) for name in there}, path)
    with zipfile.ZipFile(copy, "w") as out:
        for name, info in archive.members.items():
            if name not in filled:
                out.writestr(info.filename, archive.zipped.read(info))
                continue
            buffer = io.BytesIO()
            np.save(buffer, filled[name], allow_pickle=False)
            out.writestr(info.filename, buffer.getvalue())
    return seen
