"""Kimodo's .npz: `posed_joints` [T, J, 3] in metres, y up, and `global_rot_mats` [T, J, 3, 3].

Bodies are SOMA with 30 or 77 joints, SMPL-X with 22 and Unitree's G1 with 34; files state neither joint names nor the
framerate of 30 fps. `foot_contacts` and other arrays that can be computed from the joints are ignored. Source:
https://github.com/nv-tlabs/kimodo (skeleton/definitions.py).
"""

from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np

from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32
from motionkit.core.skeleton import SMPL22, Feet, Skeleton
from motionkit.io import joint_rotations, npy, source_file
from motionkit.io.registry import ReadOptions

FPS = Fraction(30)
JOINTS, ROTATIONS = "posed_joints", "global_rot_mats"


def skeleton_of_chains(
    name: str, chains: tuple[str, ...], ankle: str = "LeftFoot", toe: str = "LeftToeBase"
) -> Skeleton:
    """A skeleton without bone lengths, of chains of joints, each the parent of the next; right joints mirror left ones.

    >>> skeleton_of_chains("legs", ("Hips LeftFoot LeftToeBase", "Hips RightFoot RightToeBase")).parents
    (-1, 0, 1, 0, 3)
    """
    parent_of = {chains[0].split()[0]: ""}
    for chain in chains:
        joints = chain.split()
        parent_of.update(zip(joints[1:], joints[:-1], strict=True))
    names = tuple(parent_of)
    lefts = [joint for joint in names if joint.lower().startswith("left")]
    right = {left: names.index(left.replace("Left", "Right").replace("left", "right")) for left in lefts}
    return Skeleton(
        name=name,
        joint_names=names,
        parents=tuple(names.index(parent) if parent else -1 for parent in parent_of.values()),
        offsets=np.zeros((len(names), 3), np.float32),
        left_right_pairs=tuple((names.index(left), right[left]) for left in lefts),
        feet=Feet(names.index(ankle), names.index(toe), right[ankle], right[toe]),
    )


BODIES = {
    name: skeleton_of_chains(name, tuple(chains))
    for name, chains in source_file.shipped("io/bodies.toml")["chains"].items()
}


@cache
def g1() -> tuple[Skeleton, Float32[np.ndarray, "34 4"], Float32[np.ndarray, "34 3"]]:
    """Unitree G1's 34 joints with bones, their fixed rotations and hinge axes (0: none); metres, z up, x forward.

    The table is motionkit/core/skeletons/g1.toml.
    """
    table = source_file.shipped("core/skeletons/g1.toml")
    limbs = (("leg", 1, "left_"), ("leg", -1, "right_"), ("waist", 1, ""), ("arm", 1, "left_"), ("arm", -1, "right_"))
    chains, rows = [], [[0.0, 0, 0, 1, 0, 0, 0, 0, 0, 0]]
    for limb, mirror, side in limbs:
        names = [side + joint["name"] for joint in table[limb]]
        chains.append(" ".join(("waist_pitch_skel" if limb == "arm" else "pelvis_skel", *names)))
        for joint in table[limb]:
            turn = np.array(joint.get("turn", (1, 0, 0, 0))) * (1, mirror, 1, mirror)
            axis = [float(name == joint.get("axis")) for name in "xyz"]
            rows.append([*np.array(joint["offset"]) * (1, mirror, 1), *turn, *axis])
    numbers = np.array(rows, np.float32)
    skeleton = skeleton_of_chains("g1skel34", tuple(chains), "left_ankle_roll_skel", "left_toe_base")
    return replace(skeleton, offsets=numbers[:, :3]), numbers[:, 3:7], numbers[:, 7:]


SKELETONS = {each.num_joints: each for each in (SMPL22, BODIES["somaskel30"], g1()[0], BODIES["somaskel77"])}


def read_kimodo(path: Path, options: ReadOptions = ReadOptions()) -> Motion:
    """Read one file: positions, and local rotations if they reproduce these with bones of constant length.

    Raises `FormatError` (`channel-count`) for another number of joints.
    """
    data = source_file.read_bytes(path)
    archive = npy.open_archive(path, data)
    positions = archive.numbers(JOINTS, (None, None, 3))
    skeleton = SKELETONS.get(positions.shape[1])
    if skeleton is None:
        known = ", ".join(f"{count} ({each.name})" for count, each in SKELETONS.items())
        message = f"{JOINTS}: {positions.shape[1]} joints, expected {known}"
        raise FormatError(message, path=path, reason="channel-count")
    fps, operations = source_file.fps_in_use(options.fps, lambda: FPS, who="Kimodo")
    body = replace(skeleton, offsets=positions[0] - positions[0, skeleton.parents_or_self])
    motion = source_file.motion_of(path, data, "kimodo", body, fps, operations, positions=positions)
    if ROTATIONS not in archive:
        return motion
    matrices = archive.numbers(ROTATIONS, (*positions.shape[:2], 3, 3))
    return joint_rotations.with_rotations(motion, matrices, is_global=True)
