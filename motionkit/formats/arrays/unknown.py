"""Arrays that are no motion: what a .npy or .npz file holds, and the line of Python that writes one that is."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motionkit.core.errors import FormatError
from motionkit.formats.arrays import npy, npz_archive
from motionkit.formats.source import source_file

SHOWN_ARRAYS = 8
POSE_VECTOR_WIDTHS = {263: "HumanML3D", 251: "KIT-ML"}


@dataclass(frozen=True)
class _Array:
    shape: tuple[int, ...]
    code: str

    def __str__(self) -> str:
        return f"{self.shape} {self._kind()}"

    @property
    def is_joints(self) -> bool:
        """Whether it could be frames × joints × 3."""
        return len(self.shape) == 3 and self.shape[2] == 3 and npy.NUMBERS.fullmatch(self.code) is not None

    @property
    def of_pose_vectors(self) -> str:
        """The data set whose pose vectors are as wide, if there is one."""
        return POSE_VECTOR_WIDTHS.get(self.shape[1], "") if len(self.shape) == 2 else ""

    def _kind(self) -> str:
        if "O" in self.code:
            return "Python objects"
        if npy.STRINGS.fullmatch(self.code):
            return "text"
        try:
            return np.dtype(self.code).name
        except (TypeError, ValueError):
            return self.code[:40]


def describe(path: Path) -> str:
    """What arrays a file holds, and how to write one that can be read; empty for a file of another kind."""
    arrays = _arrays(path)
    if arrays is None:
        return ""
    listed = [f"{name} {array}".strip() for name, array in list(arrays.items())[:SHOWN_ARRAYS]]
    if len(arrays) > SHOWN_ARRAYS:
        listed.append(f"{len(arrays) - SHOWN_ARRAYS} more")
    return f"no motion as it is: it holds {', '.join(listed) or 'nothing'}; {_mend(path, arrays)}"


def _arrays(path: Path) -> dict[str, _Array] | None:
    match path.suffix.lower():
        case ".npy":
            header = npy.peek_header(path)
            return None if header is None else {"": _Array(header[0], header[2])}
        case ".npz":
            try:
                archive = npz_archive.open_archive(path, source_file.read_bytes(path))
                headers = {name: npz_archive.read_header(archive, name) for name in sorted(archive.members)}
            except FormatError:
                return None
            return {name: _Array(shape, code) for name, (shape, _, code) in headers.items()}
    return None


def _mend(path: Path, arrays: Mapping[str, _Array]) -> str:
    joints = next((name for name, array in arrays.items() if array.is_joints), None)
    vectors = next((name for name, array in arrays.items() if array.of_pose_vectors), None)
    if joints is None and vectors is not None:
        folder = path.with_name(f"{path.stem}-motions")
        target = str(folder / "new_joint_vecs" / f"{path.stem}.npy")
        return (
            f"write a folder that can be read, {folder}, with os.makedirs({str(Path(target).parent)!r}); "
            f"np.save({target!r}, {_loaded(path, vectors)}), if these are pose vectors as those of "
            f"{arrays[vectors].of_pose_vectors}"
        )
    target = str(path.with_name(f"{path.stem}-motion.npz"))
    if joints is None:
        source, what = "joints", "joints being frames × joints × 3, in metres, y up, and 30 their framerate"
    else:
        source, what = _loaded(path, joints), "if these are metres, y up, and 30 is their framerate"
    return f"write one that can be read with np.savez({target!r}, joint_positions={source}, fps=30), {what}"


def _loaded(path: Path, name: str) -> str:
    loaded = f"np.load({str(path)!r})"
    return f"{loaded}[{name!r}]" if name else loaded
