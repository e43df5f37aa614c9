"""Small files that the format tests write: a human-sized BVH, an ASF skeleton and an AMC motion."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

Joints = Mapping[str, tuple[str, tuple[float, float, float]]]
"""Parent (the root's is "") and offset of every joint, parents first."""

BVH_JOINTS: Joints = {
    "Hips": ("", (0, 95, 0)),
    "Spine": ("Hips", (0, 25, 0)),
    "Neck": ("Spine", (0, 27, 0)),
    "Head": ("Neck", (0, 12, 0)),
    "LeftArm": ("Spine", (18, 22, 0)),
    "LeftForeArm": ("LeftArm", (28, 0, 0)),
    "LeftHand": ("LeftForeArm", (26, 0, 0)),
    "RightArm": ("Spine", (-18, 22, 0)),
    "RightForeArm": ("RightArm", (-28, 0, 0)),
    "RightHand": ("RightForeArm", (-26, 0, 0)),
    "LeftUpLeg": ("Hips", (9, -5, 0)),
    "LeftLeg": ("LeftUpLeg", (0, -42, 0)),
    "LeftFoot": ("LeftLeg", (0, -42, 0)),
    "RightUpLeg": ("Hips", (-9, -5, 0)),
    "RightLeg": ("RightUpLeg", (0, -42, 0)),
    "RightFoot": ("RightLeg", (0, -42, 0)),
}
NUM_BVH_CHANNELS = 6 + 3 * (len(BVH_JOINTS) - 1)
TWO_JOINTS: Joints = {"Hips": ("", (0, 90, 0)), "Head": ("Hips", (0, 70, 0))}


def bvh_hierarchy(joints: Joints = BVH_JOINTS, rotations: str = "Zrotation Xrotation Yrotation") -> str:
    """By default a person in centimetres with MotionBuilder's names; feet have tips."""
    lines = ["HIERARCHY"]

    def add(name: str, indent: str) -> None:
        parent, offset = joints[name]
        lines.extend((f"{indent}{'JOINT' if parent else 'ROOT'} {name}", indent + "{"))
        lines.append(f"{indent}\tOFFSET {' '.join(f'{value:g}' for value in offset)}")
        lines.append(f"{indent}\tCHANNELS {'3' if parent else '6 Xposition Yposition Zposition'} {rotations}")
        children = [joint for joint, (above, _) in joints.items() if above == name]
        for child in children:
            add(child, indent + "\t")
        if not children:
            tip = "0 -8 15" if "Foot" in name else "0 0 0"
            lines.extend((f"{indent}\tEnd Site", indent + "\t{", f"{indent}\t\tOFFSET {tip}", indent + "\t}"))
        lines.append(indent + "}")

    add(next(iter(joints)), "")
    return "\n".join(lines) + "\n"


def bvh_text(
    rows: int | Sequence[str | Sequence[float]] = 4, frame_time: str = "0.0333333", head: str = bvh_hierarchy()
) -> str:
    """A whole BVH file of these frames; of so many that walk along +z and bend the left elbow."""
    if isinstance(rows, int):
        rest = [0.0] * (NUM_BVH_CHANNELS - 19)
        rows = [[0.0, 95.0, 2.0 * frame, *[0.0] * 15, 10.0 * frame, *rest] for frame in range(rows)]
    lines = [row if isinstance(row, str) else " ".join(f"{value:g}" for value in row) for row in rows]
    return "\n".join((f"{head}MOTION", f"Frames: {len(rows)}", f"Frame Time: {frame_time}", *lines)) + "\n"


ASF = """# a small skeleton
:version 1.10
:name test
:units
  mass 1.0
  length 0.45
  angle deg
:root
  order TX TY TZ RX RY RZ
  axis XYZ
  position 0 0 0
  orientation 0 0 0
:bonedata
  begin
    id 1
    name lfemur
    direction 0 -1 0
    length 7
    axis 0 0 20 XYZ
    dof rx ry rz
    limits (-160.0 20.0)
           (-70.0 70.0)
           (-60.0 70.0)
  end
  begin
    id 2
    name ltibia
    direction 0 -1 0
    length 7.5
    axis 10 20 30 XYZ
    dof rx
  end
:hierarchy
  begin
    root lfemur
    lfemur ltibia
  end
"""


def amc_text(num_frames: int = 3, first: int = 1) -> str:
    """A motion of the skeleton above: the root rises, the hip and the knee bend."""
    lines = ["#!OML:ASF test.ASF", ":FULLY-SPECIFIED", ":DEGREES"]
    for frame in range(num_frames):
        lines.append(str(first + frame))
        lines.append(f"root 0 {16 + frame} 0 0 {10 * frame} 0")
        lines.append(f"lfemur {5 * frame} 3.5e-015 2")
        lines.append(f"ltibia {30 + frame}")
    return "\n".join(lines) + "\n"


def write_asfamc(folder: Path, **kwargs: int) -> Path:
    """An ASF/AMC pair in a folder; returns the AMC's path."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "07.asf").write_text(ASF)
    (folder / "07_01.amc").write_text(amc_text(**kwargs))
    return folder / "07_01.amc"


def lafan1_text(num_frames: int = 80, frame_time: str = "0.033333") -> str:
    """A take with LaFAN1's joints, offsets (rounded) and channels: it stands, turns about y and walks along its way.

    Sizes are from public descriptions of the files; the motion is made up. The hips' own y axis faces forward and bones
    run along x, as there.
    """
    offsets = {
        "Hips": ("", (-224.689, 91.882, -431.625)),
        "Spine": ("Hips", (6.902, -2.604, 0.0)),
        "Spine1": ("Spine", (12.588, 0.0, 0.0)),
        "Spine2": ("Spine1", (12.343, 0.0, 0.0)),
        "Neck": ("Spine2", (25.833, 0.0, 0.0)),
        "Head": ("Neck", (11.767, 0.0, 0.0)),
    }
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        offsets |= {
            f"{side}UpLeg": ("Hips", (0.103, 1.858, sign * 10.549)),
            f"{side}Leg": (f"{side}UpLeg", (43.5, 0.0, 0.0)),
            f"{side}Foot": (f"{side}Leg", (42.372, 0.0, 0.0)),
            f"{side}Toe": (f"{side}Foot", (17.3, 0.0, 0.0)),
            f"{side}Shoulder": ("Spine2", (19.746, -1.480, sign * 6.0)),
            f"{side}Arm": (f"{side}Shoulder", (11.284, 0.0, 0.0)),
            f"{side}ForeArm": (f"{side}Arm", (33.0, 0.0, 0.0)),
            f"{side}Hand": (f"{side}ForeArm", (25.2, 0.0, 0.0)),
        }
    # Angles z, y, x that stand the body up: legs hang (a half turn from the spine's direction), toes ahead, arms out.
    pose = {"LeftUpLeg": (180, 0, 0), "RightUpLeg": (180, 0, 0), "LeftFoot": (-90, 0, 0), "RightFoot": (-90, 0, 0)}
    pose |= {"LeftShoulder": (0, -90, 0), "RightShoulder": (0, 90, 0)}
    head = bvh_hierarchy(offsets, "Zrotation Yrotation Xrotation")
    below = re.findall(r"JOINT (\w+)", head)
    rows = []
    for frame in range(num_frames):
        # The hips' x axis up, their y axis forward, which turns by 3 degrees a frame from +x.
        row = [-224.689 + 3.0 * frame, 91.882, -431.625 + 2.0 * frame, 90.0, 0.0, 180.0 + 3.0 * frame]
        rows.append([*row, *(angle for name in below for angle in pose.get(name, (0, 0, 0)))])
    return bvh_text(rows, frame_time, head)
