"""Two of B. Hahne's BVH conversions of the CMU database, from their published joint lists."""

from pathlib import Path

import numpy as np
import pytest

from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import joint_map, map_joints
from motionkit.io.bvh import T_POSE_DROPPED, read_bvh
from tests.helpers.bones import check_body

Joint = tuple[str, str, tuple[float, float, float]]


def sided(rows: list[Joint]) -> list[Joint]:
    """Rows of the left side, and the same for the right: names and x change."""
    swaps = {"Left": "Right", "L": "R", "l": "r"}
    result: list[Joint] = []
    for name, parent, (x, y, z) in rows:
        side = next(side for side in swaps if name.startswith(side))
        other = next(
            (swaps[s] + parent[len(s) :] for s in swaps if parent.startswith(s) and parent not in CENTRE), parent
        )
        result += [(name, parent, (x, y, z)), (swaps[side] + name[len(side) :], other, (-x, y, z))]
    return result


CENTRE = {"LowerBack"}

MOTIONBUILDER = [
    ("Hips", "", (0.0, 0.0, 0.0)),
    ("LowerBack", "Hips", (0.0, 0.0, 0.0)),
    ("Spine", "LowerBack", (0.0, 2.1, -0.1)),
    ("Spine1", "Spine", (0.0, 2.1, 0.0)),
    ("Neck", "Spine1", (0.0, 0.0, 0.0)),
    ("Neck1", "Neck", (0.0, 1.7, 0.0)),
    ("Head", "Neck1", (0.0, 1.6, -0.5)),
    *sided(
        [
            ("LHipJoint", "Hips", (0.0, 0.0, 0.0)),
            ("LeftUpLeg", "LHipJoint", (1.65, -1.7, 0.85)),
            ("LeftLeg", "LeftUpLeg", (2.25, -6.18, 0.0)),
            ("LeftFoot", "LeftLeg", (2.72, -7.47, 0.0)),
            ("LeftToeBase", "LeftFoot", (0.19, -0.52, 2.25)),
            ("LeftShoulder", "Spine1", (0.0, 0.0, 0.0)),
            ("LeftArm", "LeftShoulder", (3.45, 0.5, 0.22)),
            ("LeftForeArm", "LeftArm", (5.42, 0.0, 0.0)),
            ("LeftHand", "LeftForeArm", (3.2, 0.0, 0.0)),
            ("LeftFingerBase", "LeftHand", (0.0, 0.0, 0.0)),
            ("LeftHandIndex1", "LeftFingerBase", (0.73, 0.0, 0.0)),
            ("LThumb", "LeftHand", (0.0, 0.0, 0.0)),
        ]
    ),
]
DAZ = [
    ("hip", "", (0.0, 0.0, 0.0)),
    ("abdomen", "hip", (0.0, 20.7, -0.7)),
    ("chest", "abdomen", (0.0, 11.7, -0.5)),
    ("neck", "chest", (0.0, 22.2, -2.2)),
    ("head", "neck", (-0.2, 7.1, 1.2)),
    *sided(
        [
            ("leftEye", "head", (4.1, 8.0, 8.0)),
            ("lCollar", "chest", (2.7, 19.3, -4.9)),
            ("lShldr", "lCollar", (8.8, -2.0, 1.5)),
            ("lForeArm", "lShldr", (28.2, -1.7, 0.5)),
            ("lHand", "lForeArm", (22.6, 0.8, 7.1)),
            ("lThumb1", "lHand", (1.2, -0.5, 3.4)),
            ("lButtock", "hip", (8.8, 4.4, 1.2)),
            ("lThigh", "lButtock", (0.0, -1.7, -2.2)),
            ("lShin", "lThigh", (0.0, -36.8, 0.7)),
            ("lFoot", "lShin", (-0.7, -45.1, -5.1)),
        ]
    ),
]


def bvh(joints: list[Joint], root_order: str, height: float, *, t_pose: bool) -> str:
    lines, order = ["HIERARCHY"], []

    def add(name: str, parent: str, offset: tuple[float, float, float]) -> None:
        order.append(name)
        lines.extend((f"{'JOINT' if parent else 'ROOT'} {name}", "{", "OFFSET {} {} {}".format(*offset)))
        lines.append(f"CHANNELS {3 if parent else 6} {'' if parent else 'Xposition Yposition Zposition '}{root_order}")
        below = [joint for joint in joints if joint[1] == name]
        for joint in below:
            add(*joint)
        tip = "1.1 -3.7 12.1" if name.endswith("Foot") else "0 0.1 0.5"
        lines.extend(() if below else ("End Site", "{", f"OFFSET {tip}", "}"))
        lines.append("}")

    add(*joints[0])
    rows = [[0.5, height, 1.0, 1.25, -0.75, 0.5 * frame] + [0.25] * (3 * len(order) - 3) for frame in range(4)]
    if t_pose:
        rows.insert(0, [0.5, height, 1.0, *([0.0] * (3 * len(order)))])
    body = "\n".join(" ".join(f"{value:g}" for value in row) for row in rows)
    return "\n".join(lines) + f"\nMOTION\nFrames: {len(rows)}\nFrame Time: .0083333\n{body}\n"


FLAVOURS = {
    "cgspeed-motionbuilder": (MOTIONBUILDER, 17.3, True),
    "daz": (DAZ, 86.0, False),
}


def take(folder: Path, flavour: str) -> Motion:
    joints, height, t_pose = FLAVOURS[flavour]
    path = folder / "01_01.bvh"
    path.write_text(bvh(joints, "Zrotation Yrotation Xrotation", height, t_pose=t_pose))
    return read_bvh(path)


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_each_flavour_is_a_body_in_metres_at_120_fps(tmp_path: Path, flavour: str) -> None:
    motion = take(tmp_path, flavour)
    assert motion.fps == 120 and motion.num_frames == 4
    assert (T_POSE_DROPPED in motion.provenance.operations) == FLAVOURS[flavour][2]
    assert joint_map(motion.skeleton, "smpl22").family == flavour
    unit = 0.01 if flavour == "daz" else 0.0254 / 0.45
    assert motion.joint_positions[0, 0, 1] == pytest.approx(FLAVOURS[flavour][1] * unit)
    check_body(motion)


def test_daz_figures_have_their_pelvis_above_the_hips(tmp_path: Path) -> None:
    body = map_joints(take(tmp_path, "daz"), "smpl22")
    hips = body[:, [SMPL22.index("left_hip"), SMPL22.index("right_hip")]].mean(axis=1)
    assert np.allclose(body[:, 0, 1] - hips[:, 1], 0.09, atol=0.01)
