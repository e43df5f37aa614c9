"""One motion into one file, whose suffix says the format."""

from collections.abc import Callable, Mapping
from pathlib import Path

from motionkit.core.errors import UsageError
from motionkit.core.files import whole_file
from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22, STANDARD_SKELETONS
from motionkit.core.skeletons.mapping import map_joints
from motionkit.formats.arrays.joints_npy import write_joints_npy
from motionkit.formats.arrays.npz import write_npz
from motionkit.formats.bvh.writing import write_bvh
from motionkit.formats.gltf import write_gltf
from motionkit.formats.joints_csv import write_joints_csv


def _write_npy(motion: Motion, path: Path) -> None:
    if motion.skeleton not in STANDARD_SKELETONS.values():
        motion = Motion(map_joints(motion, SMPL22.name), SMPL22, motion.timegrid)
    write_joints_npy(motion, path)


WRITERS: Mapping[str, Callable[[Motion, Path], None]] = {
    ".bvh": write_bvh,
    ".csv": write_joints_csv,
    ".glb": write_gltf,
    ".npy": _write_npy,
    ".npz": write_npz,
}


def write(motion: Motion, path: str | Path) -> None:
    """Write a motion to a file; its suffix says the format.

    - `.npz`: everything that the motion knows, to the last bit
    - `.bvh`: the skeleton and its rotations, in centimetres; found by inverse kinematics where the motion has none
    - `.glb`: glTF, an animated skeleton with a visible body, for engines and viewers
    - `.csv`: time stamps and joint positions in metres
    - `.npy`: joint positions [T, J, 3] in metres of the 22 joints (KIT-ML's 21 where the motion has these), the
      framerate in `motions.json` beside the file

    Folders are made, an existing file is replaced, and the file appears whole or not at all. Raises `UsageError` for
    any other suffix, `ValueError` for an `.npy` beside those of another framerate, `MotionkitError` for one of a
    skeleton that cannot be brought to the 22 joints, and `OSError`.

    >>> motion = mk.read("walk.bvh")
    >>> mk.write(motion, "out/walk.npz")
    >>> mk.read("out/walk.npz").num_frames
    240
    """
    path = Path(path)
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        raise UsageError(f"{path}: a motion is written as {', '.join(WRITERS)}, by the suffix of the file's name")
    with whole_file(path) as temporary:
        writer(motion, temporary)
