"""A character's file, and motions written onto it; its bones, names and other contents are kept."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float64
from motionkit.core.skeleton import Skeleton
from motionkit.fields.contact.planted import planted_frames
from motionkit.fields.motion_field import Observation
from motionkit.io.bvh import BvhDocument, KnownFrames, read_document, rewrite_bvh
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
        """The motion retargeted to this rig, its path scaled by leg length; `plant` removes foot sliding.

        Raises as `retarget` does.
        """
        retargeted = retarget(motion, self.skeleton, self.rest)
        if not plant:
            return retargeted
        grid = retargeted.timegrid
        poses = planted_frames(Observation.of(retargeted), grid)(grid.seconds())
        planted = poses.at(grid, self.skeleton, retargeted.provenance)
        return planted.annotated_like(retargeted).logged("planted")


def read_character(path: Path, options: ReadOptions) -> Character:
    """Read a character's .bvh or .glb; raises `FormatError`, and `UsageError` for another file.

    The standing pose is the rest pose or, of a BVH file, else the first frame's; raises `MotionkitError` if neither
    stands.
    """
    suffix = path.suffix.lower()
    if suffix == ".bvh":
        document = read_document(path, options)
        skeleton = document.motion.skeleton
        write: Callable[[Motion, Path], None] = partial(_write_bvh, document)
        rest = None if stands(skeleton) else np.asarray(document.local_rotations[0], np.float64)
    elif suffix == ".glb":
        rig = read_rig(path, options)
        skeleton, rest, write = rig.skeleton, None, rig.write
    else:
        raise UsageError(f"{path}: a character is a .bvh or a .glb file (Blender exports both)")
    if not stands(skeleton if rest is None else standing_skeleton(skeleton, rest)):
        raise MotionkitError(f"{path}: neither its rest pose nor its first frame stands upright: put a T-pose first")
    return Character(skeleton, rest, suffix, write)


def _write_bvh(document: BvhDocument, motion: Motion, path: Path) -> None:
    first_frame, none = np.zeros(1, np.int64), np.zeros(0, np.int64)
    known = KnownFrames(first_frame, np.array([motion.timegrid.start_seconds]), none, none)
    rewrite_bvh(document, path, motion, known)


def character_format(character: Character, plant: bool) -> Format:
    """A `Format` that writes motions onto a character."""

    def write(motion: Motion, path: Path) -> None:
        character.write(character.perform(motion, plant=plant), path)

    return Format(name=character.suffix[1:], suffixes=(character.suffix,), write=write)
