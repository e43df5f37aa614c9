"""A skeleton as arrays of an .npz file, and back."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32

from motionkit.errors import FormatError, MotionkitError
from motionkit.formats.arrays import npz_archive
from motionkit.formats.arrays.npz_archive import NpzArchive
from motionkit.skeleton import STANDARD_SKELETONS, Feet, Skeleton
from motionkit.skeletons.families import parse_layout_map


def skeleton_arrays(skeleton: Skeleton) -> dict[str, Any]:
    """Everything that a skeleton is: names, parents, offsets in metres; pairs, feet, end sites, map if it has them."""
    arrays: dict[str, Any] = {
        "skeleton": np.array(skeleton.name),
        "joint_names": np.array(skeleton.joint_names),
        "parents": np.array(skeleton.parents, np.int64),
        "offsets": skeleton.offsets,
    }
    if skeleton.left_right_pairs:
        arrays["left_right_pairs"] = np.array(skeleton.left_right_pairs, np.int64)
    if (feet := skeleton.feet) is not None:
        arrays["feet"] = np.array((feet.left_ankle, feet.left_toe, feet.right_ankle, feet.right_toe), np.int64)
    if skeleton.end_sites:
        arrays["end_site_joints"] = np.array([joint for joint, _ in skeleton.end_sites], np.int64)
        arrays["end_site_offsets"] = np.array([offset for _, offset in skeleton.end_sites], np.float64)
    if skeleton.layout_map:
        arrays["layout_map"] = np.array(skeleton.layout_map)
    return arrays


def read_skeleton(archive: NpzArchive, joint_positions: Float32[np.ndarray, "frames joints 3"]) -> Skeleton:
    """The skeleton that the arrays describe; what they leave out is taken from a standard layout or from frame 0.

    Without `joint_names`, 22 joints are SMPL's and 21 KIT's. Names and parents of a standard layout are that layout.
    Without `offsets` the rest pose is that of frame 0; without `parents` all joints hang from the first. Raises
    `FormatError` (`channel-count`, `bones`).
    """
    num_joints = joint_positions.shape[1]
    if "joint_names" not in archive:
        return unnamed_skeleton(num_joints, archive.path)
    names = npz_archive.read_strings(archive, "joint_names")
    if len(names) != num_joints:
        message = f"{len(names)} joint_names for {num_joints} joints"
        raise FormatError(message, path=archive.path, reason="channel-count")
    for skeleton in STANDARD_SKELETONS.values():
        if names == skeleton.joint_names and "offsets" not in archive:
            return skeleton
    return _described(archive, names, joint_positions)


def unnamed_skeleton(num_joints: int, path: Path) -> Skeleton:
    """The standard skeleton of so many joints; raises `FormatError` (`channel-count`) where there is none."""
    for skeleton in STANDARD_SKELETONS.values():
        if skeleton.num_joints == num_joints:
            return skeleton
    message = f"{num_joints} joints without joint_names; only 22 (SMPL's) and 21 (KIT's) are known without"
    raise FormatError(message, path=path, reason="channel-count")


def checked_layout_map(text: str, path: Path) -> str:
    """A skeleton's own map as it is; raises `FormatError` (`skeleton-map`) for a text that is none."""
    try:
        if text:
            parse_layout_map(text)
    except MotionkitError as error:
        raise FormatError(str(error), path=path, reason="skeleton-map") from None
    return text


def bones_of_pose(pose: Float32[np.ndarray, "joints 3"], parents: tuple[int, ...]) -> Float32[np.ndarray, "joints 3"]:
    """Offsets in metres that make one pose the rest pose; the root's is zero."""
    above = [max(parent, 0) for parent in parents]
    return np.asarray(pose - pose[above], np.float32)


def _described(
    archive: NpzArchive, names: tuple[str, ...], joint_positions: Float32[np.ndarray, "frames joints 3"]
) -> Skeleton:
    num_joints = len(names)
    parents = (-1, *(0,) * (num_joints - 1))
    if "parents" in archive:
        parents = tuple(_indices(archive, "parents", (num_joints,), -1, num_joints).tolist())
    try:
        if "offsets" in archive:
            offsets = npz_archive.read_numbers(archive, "offsets", (num_joints, 3))
        else:
            offsets = bones_of_pose(joint_positions[0], parents)
        layout_map = "".join(npz_archive.read_strings(archive, "layout_map")) if "layout_map" in archive else ""
        name = npz_archive.read_strings(archive, "skeleton")[0] if "skeleton" in archive else archive.path.stem
        return Skeleton(
            name,
            names,
            parents,
            offsets,
            left_right_pairs=_pairs(archive, num_joints),
            feet=_feet(archive, num_joints),
            end_sites=_end_sites(archive, num_joints),
            layout_map=checked_layout_map(layout_map, archive.path),
        )
    except (ValueError, IndexError) as error:
        raise FormatError(str(error), path=archive.path, reason="bones") from None


def _pairs(archive: NpzArchive, num_joints: int) -> tuple[tuple[int, int], ...]:
    if "left_right_pairs" not in archive:
        return ()
    pairs = _indices(archive, "left_right_pairs", (None, 2), 0, num_joints).tolist()
    return tuple((left, right) for left, right in pairs)


def _feet(archive: NpzArchive, num_joints: int) -> Feet | None:
    return Feet(*_indices(archive, "feet", (4,), 0, num_joints).tolist()) if "feet" in archive else None


def _end_sites(archive: NpzArchive, num_joints: int) -> tuple[tuple[int, tuple[float, float, float]], ...]:
    if "end_site_joints" not in archive:
        return ()
    joints = _indices(archive, "end_site_joints", (None,), 0, num_joints).tolist()
    offsets = npz_archive.read_exact(archive, "end_site_offsets", (len(joints), 3)).tolist()
    return tuple((joint, (x, y, z)) for joint, (x, y, z) in zip(joints, offsets, strict=True))


def _indices(archive: NpzArchive, key: str, shape: tuple[int | None, ...], low: int, high: int) -> np.ndarray:
    found = npz_archive.read_exact(archive, key, shape)
    if not ((found >= low) & (found < high) & (found == np.rint(found))).all():
        message = f"{key}: joints are numbered {low} … {high - 1}, these are not"
        raise FormatError(message, path=archive.path, reason="bones")
    return found.astype(np.int64)
