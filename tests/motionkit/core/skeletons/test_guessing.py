"""Maps that are guessed: rigs of seven tools, and trees that are no bodies'."""

from pathlib import Path

import numpy as np
import pytest

from motionkit.core.errors import MotionkitError
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.skeletons.families import read_skeleton_map, with_layout_map
from motionkit.core.skeletons.guessing import guess_map, map_text
from motionkit.core.skeletons.mapping import joint_map, rest_positions


def tree(*chains: str) -> Skeleton:
    names: list[str] = []
    parents: list[int] = []
    for words in map(str.split, chains):
        for above, name in zip(["", *words], words, strict=False):
            if name not in names:
                names.append(name)
                parents.append(names.index(above) if above else -1)
    return Skeleton("rig", tuple(names), tuple(parents), np.tile(np.float32([0.01, 0.1, 0]), (len(names), 1)))


def body(sides: tuple[str, str], leg: str, arm: str, head: str) -> Skeleton:
    return tree(*(leg.replace("*", side) for side in sides), *(arm.replace("*", side) for side in sides), head)


RIGS = {
    "MakeHuman": (
        body(
            ("L", "R"),
            "root pelvis.* upperleg01.* upperleg02.* lowerleg01.* lowerleg02.* foot.* toe1-1.*",
            "root spine05 spine04 spine03 spine02 spine01 clavicle.* shoulder01.* upperarm01.* upperarm02.* "
            "lowerarm01.* lowerarm02.* wrist.* finger1-1.*",
            "spine01 neck01 neck02 neck03 head jaw",
        ),
        "root upperleg01.L upperleg01.R lowerleg01.L foot.R toe1-1.L neck01 clavicle.L head upperarm01.R lowerarm01.L "
        "wrist.R",
    ),
    "ControlVAE": (
        body(
            ("l", "r"),
            "RootJoint *Hip *Knee *Ankle *ToeJoint",
            "RootJoint pelvis_lowerback lowerback_torso *Torso_Clavicle *Shoulder *Elbow *Wrist",
            "lowerback_torso torso_head",
        ),
        "RootJoint lHip rHip lKnee rAnkle lToeJoint - lTorso_Clavicle torso_head rShoulder lElbow rWrist",
    ),
    "no neck": (
        body(
            ("Left", "Right"),
            "Hips *UpLeg *Leg *Foot *ToeBase",
            "Hips Spine *Arm *ForeArm *Hand",
            "Spine Head",
        ),
        "Hips LeftUpLeg RightUpLeg LeftLeg RightFoot LeftToeBase - - Head RightArm LeftForeArm RightHand",
    ),
    "Unreal": (
        body(
            ("l", "r"),
            "root pelvis thigh_* calf_* foot_* ball_*",
            "pelvis spine_01 spine_02 spine_03 clavicle_* upperarm_* lowerarm_* hand_* index_01_*",
            "spine_03 neck_01 head",
        ),
        "pelvis thigh_l thigh_r calf_l foot_r ball_l neck_01 clavicle_l head upperarm_r lowerarm_l hand_r",
    ),
    "Mixamo": (
        body(
            ("Left", "Right"),
            "m:Hips m:*UpLeg m:*Leg m:*Foot m:*ToeBase",
            "m:Hips m:Spine m:Spine1 m:Spine2 m:*Shoulder m:*Arm m:*ForeArm m:*Hand m:*HandIndex1",
            "m:Spine2 m:Neck m:Head",
        ),
        "m:Hips m:LeftUpLeg m:RightUpLeg m:LeftLeg m:RightFoot m:LeftToeBase m:Neck m:LeftShoulder m:Head m:RightArm "
        "m:LeftForeArm m:RightHand",
    ),
    "SOMA": (
        body(
            ("Left", "Right"),
            "Hips *Leg *Shin *Foot *ToeBase",
            "Hips Spine1 Chest *Shoulder *Arm *ForeArm *Hand",
            "Chest Neck1 Head",
        ),
        "Hips LeftLeg RightLeg LeftShin RightFoot LeftToeBase Neck1 LeftShoulder Head RightArm LeftForeArm RightHand",
    ),
}
JOINTS = (
    *("pelvis", "left_hip", "right_hip", "left_knee", "right_ankle", "left_foot", "neck", "left_collar", "head"),
    *("right_shoulder", "left_elbow", "right_wrist"),
)


@pytest.mark.parametrize("name", RIGS)
def test_rigs_of_many_tools(name: str, tmp_path: Path) -> None:
    skeleton, expected = RIGS[name]
    made = guess_map(skeleton)
    assert {joint: made[joint] for joint, own in zip(JOINTS, expected.split(), strict=True) if own != "-"} == {
        joint: own for joint, own in zip(JOINTS, expected.split(), strict=True) if own != "-"
    }
    (tmp_path / "rig.toml").write_text(map_text(skeleton, "rig"))
    mapped = joint_map(with_layout_map(skeleton, [read_skeleton_map(tmp_path / "rig.toml")]), SMPL22.name)
    assert mapped.family == "rig"
    heights = (mapped.weights @ rest_positions(skeleton))[:, 1]
    spine = [heights[SMPL22.index(joint)] for joint in ("pelvis", "spine1", "spine2", "spine3", "head")]
    assert spine == sorted(spine)


@pytest.mark.parametrize(
    "chains",
    [
        ("root a b c d",),
        ("Hips LeftUpLeg LeftLeg LeftFoot", "Hips RightUpLeg RightLeg RightFoot", "Hips Spine Head"),
        ("Hips LeftArm LeftForeArm LeftHand", "Hips RightArm RightForeArm RightHand"),
        ("LASI",),
    ],
)
def test_what_is_no_body_is_reported(chains: tuple[str, ...]) -> None:
    with pytest.raises(MotionkitError, match="no body by its tree"):
        guess_map(tree(*chains))
