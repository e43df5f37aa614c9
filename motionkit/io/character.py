"""A character's file, and motions written onto it; its bones, names and other contents are kept."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float64
from motionkit.core.skeleton import Skeleton
from motionkit.fields.contact.planted import planted_frames
from motionkit.fields.motion_field import Observation
from motionkit.io.bvh import BvhDocument, read_document
from motionkit.io.bvh_writing import KnownFrames, check_writable, rewrite_bvh
from motionkit.io.gltf import read_rig
from motionkit.io.registry import Format, ReadOptions
from motionkit.io.retargeting import retarget, standing_skeleton, stands


@dataclass(frozen=True, eq=False)
class Character:
    """A retargeting target: its skeleton, local rotations of its standing pose (None: identity), and its writer."""

    skeleton: Skeleton
    rest: Float64[np.ndarray, "joints 4"] | None
    suffix: str
    write: Callable[[Motion, Path], None]

    def perform(self, motion: Motion, *, plant: bool = False) -> Motion:
        """The motion retargeted to this rig, its path scaled by leg length; `plant` removes foot sliding. Raises as
        `retarget` does.
        """
        retargeted = retarget(motion, self.skeleton, self.rest)
        if not plant:
            return retargeted
        grid = retargeted.timegrid
        poses = planted_frames(Observation.of(retargeted), grid).query(grid.seconds())
        planted = poses.at(grid, self.skeleton, retargeted.provenance)
        return planted.annotated_like(retargeted).logged("planted")


def read_character(path: Path, options: ReadOptions) -> Character:
    """Read a character's .bvh or .glb; raises `FormatError`, and `UsageError` for another file or a rig without a
    standing pose.
    """
    if path.suffix.lower() == ".bvh":
        document = read_document(path, options)
        check_writable(document)
        return Character(document.motion.skeleton, _standing_pose(document), ".bvh", _bvh_writer(document))
    if path.suffix.lower() == ".glb":
        rig = read_rig(path, options)
        _check_stands(standing_skeleton(rig.skeleton, rig.rest), path)
        return Character(rig.skeleton, rig.rest, ".glb", rig.write)
    raise UsageError(f"{path}: a character is a .bvh or a .glb file (Blender exports both)")


def character_format(character: Character, plant: bool) -> Format:
    """A `Format` that writes motions onto a character."""

    def write(motion: Motion, path: Path) -> None:
        character.write(character.perform(motion, plant=plant), path)

    return Format(name=character.suffix[1:], suffixes=(character.suffix,), write=write)


def _standing_pose(document: BvhDocument) -> Float64[np.ndarray, "joints 4"] | None:
    """None if the rest pose stands; else the first frame's rotations, if that pose does."""
    if stands(document.motion.skeleton):
        return None
    rest = np.asarray(document.local_rotations[0], np.float64)
    _check_stands(standing_skeleton(document.motion.skeleton, rest), document.path)
    return rest


def _check_stands(skeleton: Skeleton, path: Path) -> None:
    if not stands(skeleton):
        raise MotionkitError(
            f"{path}: neither its rest pose nor its first frame stands upright, as a T-pose or an A-pose does: put one "
            "of these first"
        )


def _bvh_writer(document: BvhDocument) -> Callable[[Motion, Path], None]:
    def write(motion: Motion, path: Path) -> None:
        first_frame, none = np.zeros(1, np.int64), np.zeros(0, np.int64)
        known = KnownFrames(first_frame, np.array([motion.timegrid.start_seconds]), none, none)
        rewrite_bvh(document, path, motion, known)

    return write
