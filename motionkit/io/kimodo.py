"""Kimodo's .npz: `posed_joints` [T, J, 3] in metres, y up, and `global_rot_mats` [T, J, 3, 3].

Bodies are SOMA with 30 or 77 joints and SMPL-X with 22; files state neither joint names nor the framerate of 30 fps.
`foot_contacts` and other arrays that can be computed from the joints are ignored. Source:
https://github.com/nv-tlabs/kimodo (skeleton/definitions.py).
"""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from motionkit.core.errors import FormatError
from motionkit.core.framerate import parse_fps
from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22, Feet, Skeleton
from motionkit.core.timegrid import TimeGrid
from motionkit.io import joint_rotations, npy, source_file
from motionkit.io.registry import FileHead, Format, ReadOptions, of_path

Bones = tuple[tuple[str, str], ...]
"""Joints, each with its parent."""

FPS = Fraction(30)
JOINTS, ROTATIONS = "posed_joints", "global_rot_mats"
TRUNK = (("Hips", ""), ("Spine1", "Hips"), ("Spine2", "Spine1"), ("Chest", "Spine2"), ("Neck1", "Chest"))
HEAD = (("Neck2", "Neck1"), ("Head", "Neck2"))
FACE = (("Jaw", "Head"), ("LeftEye", "Head"), ("RightEye", "Head"))
ARM = (("Shoulder", "Chest"), ("Arm", "Shoulder"), ("ForeArm", "Arm"), ("Hand", "ForeArm"))
LEG = (("Leg", "Hips"), ("Shin", "Leg"), ("Foot", "Shin"), ("ToeBase", "Foot"))


def _sided(side: str, bones: Bones) -> Bones:
    return tuple((side + joint, above if above in ("Chest", "Hips") else side + above) for joint, above in bones)


def _finger(name: str, bones: tuple[str, ...]) -> Bones:
    chain = ("Hand", *(f"Hand{name}{bone}" for bone in bones))
    return tuple(zip(chain[1:], chain[:-1], strict=True))


_FINGERS = _finger("Thumb", ("1", "2", "3", "End")) + tuple(
    bone for name in ("Index", "Middle", "Ring", "Pinky") for bone in _finger(name, ("1", "2", "3", "4", "End"))
)
_STUMPS = (("HandThumbEnd", "Hand"), ("HandMiddleEnd", "Hand"))


def _soma(name: str, head: Bones, arm: Bones, leg: Bones) -> Skeleton:
    limbs = (each for limb in (arm, leg) for side in ("Left", "Right") for each in _sided(side, limb))
    bones = (*TRUNK, *head, *limbs)
    names = tuple(joint for joint, _ in bones)
    return Skeleton(
        name=name,
        joint_names=names,
        parents=tuple(names.index(above) if above else -1 for _, above in bones),
        offsets=np.zeros((len(names), 3), np.float32),
        left_right_pairs=tuple(
            (place, names.index(f"Right{joint[4:]}")) for place, joint in enumerate(names) if joint.startswith("Left")
        ),
        feet=Feet(*(names.index(joint) for joint in ("LeftFoot", "LeftToeBase", "RightFoot", "RightToeBase"))),
    )


SKELETONS = {
    each.num_joints: each
    for each in (
        SMPL22,
        _soma("somaskel30", (*HEAD, *FACE), (*ARM, *_STUMPS), LEG),
        _soma("somaskel77", (*HEAD, ("HeadEnd", "Head"), *FACE), (*ARM, *_FINGERS), (*LEG, ("ToeEnd", "ToeBase"))),
    )
}


def accepts(head: FileHead) -> bool:
    """Whether an .npz file has the joints under Kimodo's name."""
    return JOINTS in head.array_names


def read_kimodo(path: Path, options: ReadOptions | None = None) -> Motion:
    """Read one file: positions, and local rotations if they reproduce these with bones of constant length.

    Raises `FormatError` (`channel-count`) for another number of joints, such as the robot's 34.
    """
    options = options or ReadOptions()
    data = source_file.read_bytes(path)
    archive = npy.open_archive(path, data)
    positions = archive.numbers(JOINTS, (None, None, 3))
    skeleton = SKELETONS.get(positions.shape[1])
    if skeleton is None:
        known = ", ".join(f"{count} ({each.name})" for count, each in SKELETONS.items())
        message = f"{JOINTS}: {positions.shape[1]} joints, expected {known}"
        raise FormatError(message, path=path, reason="channel-count")
    fps, stated, operations = _framerate(archive, options)
    body = replace(skeleton, offsets=positions[0] - positions[0, skeleton.parents_or_self])
    motion = Motion(
        positions,
        body,
        TimeGrid(fps, len(positions)),
        sequence_id=path.stem,
        provenance=source_file.provenance(path, data, "kimodo", operations, stated_fps=stated),
    )
    if ROTATIONS not in archive:
        return motion
    matrices = archive.numbers(ROTATIONS, (*positions.shape[:2], 3, 3))
    local = np.einsum("tjki,tjkl->tjil", matrices[:, skeleton.parents_or_self], matrices)
    local[:, 0] = matrices[:, 0]
    return joint_rotations.with_rotations(motion, local)


def _framerate(archive: npy.Archive, options: ReadOptions) -> tuple[Fraction, str, list[str]]:
    value = archive.scalar("fps") if "fps" in archive else None
    try:
        fps, who = (FPS, "Kimodo") if value is None else (parse_fps(value), "the file")
    except ValueError as error:
        raise FormatError(f"fps: {value} ({error})", path=archive.path, reason="framerate") from None
    used = options.fps or fps
    return used, "" if value is None else str(value), source_file.replaced_fps(used, fps, who=who)


FORMAT = Format(name="kimodo", read=of_path(read_kimodo), suffixes=(".npz",), accepts=accepts)
