"""The 22 joints of each motion as a plain array, all at one framerate."""

from collections.abc import Iterator
from pathlib import Path

from motionkit.errors import UsageError
from motionkit.export.files import write_files
from motionkit.export.names import flat_names
from motionkit.export.selection import Outcome, Selection
from motionkit.formats.arrays.joints_npy import write_joints_npy
from motionkit.motion import Motion
from motionkit.skeleton import SMPL22
from motionkit.skeletons.mapping import map_joints
from motionkit.timegrid import format_fps


def export_joints_npy(selection: Selection, folder: Path) -> Iterator[Outcome]:
    """Write each motion's 22 joints in metres to `folder/ID.npy`, their framerate to `motions.json`.

    Raises `UsageError` where framerates differ: a folder of joints has one.
    """
    if len(selection.framerates) > 1:
        *most, last = [format_fps(fps) for fps in selection.framerates]
        found = f"{', '.join(most)} and {last}"
        raise UsageError(f"a folder of joints has one framerate, the sequences have {found}: give one with --fps")
    return write_files(selection, folder, flat_names(selection.sequence_ids, ".npy"), _write)


def _write(motion: Motion, path: Path) -> None:
    joints = Motion(map_joints(motion, SMPL22.name), SMPL22, motion.timegrid, sequence_id=motion.sequence_id)
    write_joints_npy(joints, path)
