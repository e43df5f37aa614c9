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
from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22, Feet, Skeleton
from motionkit.core.timegrid import TimeGrid
from motionkit.io import joint_rotations, npy, source_file
from motionkit.io.registry import Format, ReadOptions, of_path

FPS = Fraction(30)
JOINTS, ROTATIONS = "posed_joints", "global_rot_mats"
# Chains of joints, the first of which is the parent of the second; * is Left and then Right.
SPINE = ("Hips Spine1 Spine2 Chest Neck1 Neck2 Head",)
FACE = ("Head Jaw", "Head LeftEye", "Head RightEye")
ARM, LEG = ("Chest *Shoulder *Arm *ForeArm *Hand",), ("Hips *Leg *Shin *Foot *ToeBase",)
STUMPS = ("*Hand *HandThumbEnd", "*Hand *HandMiddleEnd")
FINGERS = (
    "*Hand *HandThumb1 *HandThumb2 *HandThumb3 *HandThumbEnd",
    "*Hand *HandIndex1 *HandIndex2 *HandIndex3 *HandIndex4 *HandIndexEnd",
    "*Hand *HandMiddle1 *HandMiddle2 *HandMiddle3 *HandMiddle4 *HandMiddleEnd",
    "*Hand *HandRing1 *HandRing2 *HandRing3 *HandRing4 *HandRingEnd",
    "*Hand *HandPinky1 *HandPinky2 *HandPinky3 *HandPinky4 *HandPinkyEnd",
)


def _soma(name: str, trunk: tuple[str, ...], arm: tuple[str, ...], leg: tuple[str, ...]) -> Skeleton:
    limbs = (chain.replace("*", side) for limb in (arm, leg) for side in ("Left", "Right") for chain in limb)
    parent_of = {"Hips": ""}
    for chain in (*trunk, *limbs):
        joints = chain.split()
        parent_of.update(zip(joints[1:], joints[:-1], strict=True))
    names = tuple(parent_of)
    lefts = [joint for joint in names if joint.startswith("Left")]
    return Skeleton(
        name=name,
        joint_names=names,
        parents=tuple(names.index(parent) if parent else -1 for parent in parent_of.values()),
        offsets=np.zeros((len(names), 3), np.float32),
        left_right_pairs=tuple((names.index(joint), names.index(f"Right{joint[4:]}")) for joint in lefts),
        feet=Feet(*(names.index(joint) for joint in ("LeftFoot", "LeftToeBase", "RightFoot", "RightToeBase"))),
    )


SKELETONS = {
    each.num_joints: each
    for each in (
        SMPL22,
        _soma("somaskel30", (*SPINE, *FACE), (*ARM, *STUMPS), LEG),
        _soma("somaskel77", (*SPINE, "Head HeadEnd", *FACE), (*ARM, *FINGERS), (*LEG, "*ToeBase *ToeEnd")),
    )
}


def read_kimodo(path: Path, options: ReadOptions = ReadOptions()) -> Motion:
    """Read one file: positions, and local rotations if they reproduce these with bones of constant length.

    Raises `FormatError` (`channel-count`) for another number of joints, such as the robot's 34.
    """
    data = source_file.read_bytes(path)
    archive = npy.open_archive(path, data)
    positions = archive.numbers(JOINTS, (None, None, 3))
    skeleton = SKELETONS.get(positions.shape[1])
    if skeleton is None:
        known = ", ".join(f"{count} ({each.name})" for count, each in SKELETONS.items())
        message = f"{JOINTS}: {positions.shape[1]} joints, expected {known}"
        raise FormatError(message, path=path, reason="channel-count")
    fps = options.fps or FPS
    operations = source_file.replaced_fps(fps, FPS, who="Kimodo")
    body = replace(skeleton, offsets=positions[0] - positions[0, skeleton.parents_or_self])
    motion = Motion(
        positions,
        body,
        TimeGrid(fps, len(positions)),
        sequence_id=path.stem,
        provenance=source_file.provenance(path, data, "kimodo", operations),
    )
    if ROTATIONS not in archive:
        return motion
    matrices = archive.numbers(ROTATIONS, (*positions.shape[:2], 3, 3))
    local = np.einsum("tjki,tjkl->tjil", matrices[:, skeleton.parents_or_self], matrices)
    local[:, 0] = matrices[:, 0]
    return joint_rotations.with_rotations(motion, local)


FORMAT = Format(
    name="kimodo", read=of_path(read_kimodo), suffixes=(".npz",), accepts=lambda head: JOINTS in head.array_names
)
