"""Small files that the format tests write: a human-sized BVH, an ASF skeleton and an AMC motion."""

from pathlib import Path

BVH_JOINTS = (
    ("Hips", None, (0, 95, 0)),
    ("Spine", "Hips", (0, 25, 0)),
    ("Neck", "Spine", (0, 27, 0)),
    ("Head", "Neck", (0, 12, 0)),
    ("LeftArm", "Spine", (18, 22, 0)),
    ("LeftForeArm", "LeftArm", (28, 0, 0)),
    ("LeftHand", "LeftForeArm", (26, 0, 0)),
    ("RightArm", "Spine", (-18, 22, 0)),
    ("RightForeArm", "RightArm", (-28, 0, 0)),
    ("RightHand", "RightForeArm", (-26, 0, 0)),
    ("LeftUpLeg", "Hips", (9, -5, 0)),
    ("LeftLeg", "LeftUpLeg", (0, -42, 0)),
    ("LeftFoot", "LeftLeg", (0, -42, 0)),
    ("RightUpLeg", "Hips", (-9, -5, 0)),
    ("RightLeg", "RightUpLeg", (0, -42, 0)),
    ("RightFoot", "RightLeg", (0, -42, 0)),
)
NUM_BVH_CHANNELS = 6 + 3 * (len(BVH_JOINTS) - 1)


def bvh_hierarchy() -> str:
    """A centimetre-sized person with MotionBuilder names; feet have End Sites."""
    lines = ["HIERARCHY"]

    def add(name: str, indent: str) -> None:
        parent, offset = next((parent, offset) for joint, parent, offset in BVH_JOINTS if joint == name)
        lines.extend((f"{indent}{'JOINT' if parent else 'ROOT'} {name}", indent + "{"))
        lines.append(f"{indent}\tOFFSET {offset[0]} {offset[1]} {offset[2]}")
        places = "" if parent else "Xposition Yposition Zposition "
        lines.append(f"{indent}\tCHANNELS {3 if parent else 6} {places}Zrotation Xrotation Yrotation")
        children = [joint for joint, above, _ in BVH_JOINTS if above == name]
        for child in children:
            add(child, indent + "\t")
        if not children:
            tip = "0 -8 15" if "Foot" in name else "0 0 0"
            lines.extend((f"{indent}\tEnd Site", indent + "\t{", f"{indent}\t\tOFFSET {tip}", indent + "\t}"))
        lines.append(indent + "}")

    add("Hips", "")
    return "\n".join(lines) + "\n"


def bvh_text(rows: list[list[float]] | None = None, frame_time: str = "0.0333333") -> str:
    """A whole BVH file; by default four frames that walk along +z and bend the left elbow."""
    if rows is None:
        rows = []
        for frame in range(4):
            row = [0.0] * NUM_BVH_CHANNELS
            row[1], row[2], row[6 + 3 * 4] = 95.0, 2.0 * frame, 10.0 * frame
            rows.append(row)
    body = "\n".join(" ".join(f"{value:g}" for value in row) for row in rows)
    return f"{bvh_hierarchy()}MOTION\nFrames: {len(rows)}\nFrame Time: {frame_time}\n{body}\n"


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
