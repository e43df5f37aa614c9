"""A file for each motion, in the formats that hold one motion each: .npz, BVH, glTF, CSV, .npy."""

from collections.abc import Iterator
from pathlib import Path

from motionkit.core.errors import UsageError
from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import map_joints
from motionkit.core.timegrid import format_fps
from motionkit.export.files import write_files
from motionkit.export.selection import Outcome, Selection, flat_names, nested_names
from motionkit.formats.arrays.joints_npy import write_joints_npy
from motionkit.formats.arrays.npz import write_npz
from motionkit.formats.bvh.writing import write_bvh
from motionkit.formats.gltf import write_gltf
from motionkit.formats.joints_csv import write_joints_csv


def export_npz(selection: Selection, folder: Path) -> Iterator[Outcome]:
    """Write each motion to `folder/ID.npz` (`motionkit.formats.arrays.npz`)."""
    return write_files(selection, folder, nested_names(selection.sequence_ids, ".npz"), write_npz)


def export_bvh(selection: Selection, folder: Path) -> Iterator[Outcome]:
    """Write each motion to `folder/ID.bvh` in centimetres (`write_bvh`)."""
    return write_files(selection, folder, nested_names(selection.sequence_ids, ".bvh"), write_bvh)


def export_gltf(selection: Selection, folder: Path) -> Iterator[Outcome]:
    """Write each motion to `folder/ID.glb` (`motionkit.formats.gltf`)."""
    return write_files(selection, folder, nested_names(selection.sequence_ids, ".glb"), write_gltf)


def export_joints_csv(selection: Selection, folder: Path) -> Iterator[Outcome]:
    """Write each motion's joints in metres to `folder/ID.csv` (`motionkit.formats.joints_csv`); bones are not kept."""
    return write_files(selection, folder, nested_names(selection.sequence_ids, ".csv"), write_joints_csv)


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
