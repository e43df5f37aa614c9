"""Maps of skeletons to the standard layouts: shipped families, users' tables, and real bodies."""

import copy
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from motionkit.core.skeletons.mapping import (
    SkeletonMapError,
    draft_map,
    joint_map,
    map_joints,
    parse_layout_map,
    read_skeleton_map,
    rest_positions,
    with_layout_map,
)
from motionkit.core.timegrid import TimeGrid, parse_fps
from motionkit.io.npz import read_npz, write_npz
from motionkit.io.registry import ReadOptions
from motionkit.io.scan import read, scan
from tests.helpers.bones import check_body
from tests.helpers.format_samples import bvh_text
from tests.helpers.refusal import refusal


def tree(*chains: str) -> mk.Skeleton:
    names: list[str] = []
    parents: list[int] = []
    for words in map(str.split, chains):
        for above, name in zip(["", *words], words, strict=False):
            if name not in names:
                names.append(name)
                parents.append(names.index(above) if above else -1)
    return mk.Skeleton("rig", tuple(names), tuple(parents), np.tile(np.float32([0.01, 0.1, 0]), (len(names), 1)))


def body(sides: tuple[str, str], leg: str, arm: str, head: str) -> mk.Skeleton:
    return tree(*(leg.replace("*", side) for side in sides), *(arm.replace("*", side) for side in sides), head)


# The sample BVH's joints under names that no shipped family knows.
ROBOT = {
    "Hips": "base",
    "Spine": "torso_mid",
    "Neck": "throat",
    "Head": "skull",
    **{f"{side}{old}": f"{side[0]}-{new}" for side in ("Left", "Right") for old, new in {
        "Arm": "upper arm", "ForeArm": "lower arm", "Hand": "gripper", "UpLeg": "thigh", "Leg": "shank", "Foot": "sole"
    }.items()},
}  # fmt: skip


def robot_bvh() -> str:
    lines = []
    for line in bvh_text().splitlines():
        words = line.split()
        renamed = words and words[0] in ("ROOT", "JOINT")
        lines.append(f"{line[: line.index(words[0])]}{words[0]} {ROBOT[words[1]]}" if renamed else line)
    return "\n".join(lines) + "\n"


def robot_map(**changes: str) -> str:
    rows = {
        "pelvis": '"base"',
        "spine1": "{ base = 0.5, torso_mid = 0.5 }",
        "spine2": '"torso_mid"',
        "spine3": '["chest", { torso_mid = 0.5, throat = 0.5 }]',
        "neck": '"throat"',
        "head": '"skull"',
    }
    for side in ("left", "right"):
        first = side[0].upper()
        for joint, source in {
            "hip": "thigh", "knee": "shank", "ankle": "sole", "foot": "sole.tip", "collar": "upper arm",
            "shoulder": "upper arm", "elbow": "lower arm", "wrist": "gripper",
        }.items():  # fmt: skip
            rows[f"{side}_{joint}"] = f'"{first}-{source}"'
    rows |= changes
    body = "\n".join(f"{joint} = {row}" for joint, row in rows.items() if row)
    return f'name = "robot"\nrequires = ["base", "torso_mid", "skull"]\n[smpl22]\n{body}\n'


def write_map(folder: Path, text: str) -> Path:
    path = folder / "my-rig.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_users_map_reaches_the_22_joints_and_travels_with_the_skeleton(tmp_path: Path) -> None:
    folder = tmp_path / "takes"
    folder.mkdir()
    (folder / "walk.bvh").write_text(robot_bvh())
    (item,) = scan([folder]).items
    plain = read(item)
    with pytest.raises(SkeletonMapError):
        joint_map(plain.skeleton, "smpl22")
    layout_map = read_skeleton_map(write_map(tmp_path, robot_map()))
    motion = read(item, ReadOptions(skeleton_maps=(layout_map,)))
    assert motion.skeleton.layout_map == layout_map
    assert motion.skeleton != plain.skeleton and motion.skeleton.fingerprint != plain.skeleton.fingerprint
    body = map_joints(motion, "smpl22")
    names = motion.skeleton.joint_names
    assert np.allclose(body[:, mk.SMPL22.index("left_wrist")], motion.joint_positions[:, names.index("L-gripper")])
    middle = motion.joint_positions[:, [names.index("torso_mid"), names.index("throat")]].mean(axis=1)
    assert np.allclose(body[:, mk.SMPL22.index("spine3")], middle, atol=1e-6)
    mapping = joint_map(motion.skeleton, "smpl22")
    assert mapping.family == "robot" and not mapping.made_up
    assert map_joints(motion, "kit21").shape == (4, 21, 3)


def test_a_map_is_preferred_to_a_shipped_family_and_the_most_demanding_one_wins() -> None:
    general = '{"name":"general","requires":["pelvis"],"smpl22":' + rows_of_smpl22() + "}"
    special = '{"name":"special","requires":["pelvis","head"],"smpl22":' + rows_of_smpl22() + "}"
    other = '{"name":"other","requires":["tail"],"smpl22":' + rows_of_smpl22() + "}"
    skeleton = with_layout_map(mk.SMPL22, (other, general, special))
    assert parse_layout_map(skeleton.layout_map).name == "special"
    assert joint_map(skeleton, "smpl22").family == "special"
    assert with_layout_map(skeleton, (general,)) is skeleton and with_layout_map(mk.SMPL22, (other,)) is mk.SMPL22
    assert skeleton != mk.SMPL22 and with_layout_map(mk.SMPL22, (special,)) == skeleton


def rows_of_smpl22() -> str:
    return "{" + ",".join(f'"{name}":"{name}"' for name in mk.SMPL22.joint_names) + "}"


def test_joints_that_a_map_does_not_reach(tmp_path: Path) -> None:
    """Toes are made up; any other is an error that names it."""
    names = tuple(ROBOT.values())
    skeleton = mk.Skeleton("robot", names, (-1, *([0] * (len(names) - 1))), np.zeros((len(names), 3), np.float32))
    toeless = read_skeleton_map(write_map(tmp_path, robot_map(left_foot="", right_foot="")))
    assert joint_map(with_layout_map(skeleton, (toeless,)), "smpl22").made_up == ("left_foot", "right_foot")
    other = read_skeleton_map(write_map(tmp_path, robot_map(left_wrist='"L-hand"', neck='["gullet", "gorge"]')))
    with pytest.raises(SkeletonMapError, match="'robot'") as error:
        joint_map(with_layout_map(skeleton, (other,)), "smpl22")
    assert error.value.missing == ("neck", "left_wrist")


def test_a_map_travels_in_an_npz_file(tmp_path: Path) -> None:
    layout_map = read_skeleton_map(write_map(tmp_path, robot_map()))
    (tmp_path / "walk.bvh").write_text(robot_bvh())
    (item,) = scan([tmp_path / "walk.bvh"]).items
    motion = read(item, ReadOptions(skeleton_maps=(layout_map,)))
    write_npz(motion, tmp_path / "walk.npz")
    again = read_npz(tmp_path / "walk.npz")
    assert again.skeleton == motion.skeleton and again.skeleton.layout_map == layout_map
    with np.load(tmp_path / "walk.npz") as arrays:
        np.savez(tmp_path / "bad.npz", **{**arrays, "layout_map": np.array("{}")})
    with pytest.raises(mk.FormatError, match=r"bad\.npz"):
        read_npz(tmp_path / "bad.npz")


BAD = {
    'name = "robot"\nrequires = [': "line 2",
    robot_map() + 'tail = "sole"\n': "'tail'",
    robot_map(neck=""): "neck",
    robot_map(spine1="{ base = 0.5, torso_mid = 0.6 }"): "spine1",
    robot_map(spine1="3"): "spine1 = 3",
    robot_map().replace("requires", "require"): "'require'",
    robot_map().replace('["base", "torso_mid", "skull"]', "[]"): "requires",
    'name = "robot"\nrequires = ["base"]\n': "smpl22",
    "units_per_metre = -1\n" + robot_map(): "units_per_metre = -1",
    "aliases = { a = 1 }\n" + robot_map(): "aliases",
}


@pytest.mark.parametrize("text", BAD)
def test_a_bad_map_is_reported_by_file_and_key(tmp_path: Path, text: str) -> None:
    error = refusal(read_skeleton_map, write_map(tmp_path, text))
    assert error.reason == "skeleton-map" and BAD[text] in str(error)
    (tmp_path / "my-rig.toml").write_bytes(b"name = '\xff'")
    assert refusal(read_skeleton_map, tmp_path / "my-rig.toml").path == tmp_path / "my-rig.toml"


def test_a_draft_has_the_joints_that_are_called_as_others_and_names_the_rest(tmp_path: Path) -> None:
    skeleton = body(("l", "r"), "base *Hip *Knee *Ankle", "base chest *Shoulder *Elbow *Gripper", "chest skull")
    text = draft_map(skeleton, "robot")
    assert {'left_knee = "lknee"', '# left_wrist = ""', '# pelvis = ""', 'name = "robot"'} <= set(text.split("\n"))
    assert "left_wrist" in str(refusal(read_skeleton_map, write_map(tmp_path, text)))
    completed = re.sub(r'# (pelvis|spine.) = ""', r'\1 = "base"', text)
    completed = re.sub(r'# (neck|.*_collar) = ""', r'\1 = "chest"', completed)
    completed = re.sub(r'# (head|.*_wrist) = ""', lambda row: f'{row[1]} = "{row[1][0]}Gripper"', completed)
    completed = completed.replace('"hGripper"', '"skull"')
    fitted = with_layout_map(skeleton, [read_skeleton_map(write_map(tmp_path, completed))])
    mapped = joint_map(fitted, "smpl22")
    assert mapped.family == "robot" and mapped.made_up == ("left_foot", "right_foot")
    assert mapped.weights[mk.SMPL22.index("right_wrist"), skeleton.index("rGripper")] == 1.0


# Rigs of engines, and joints that are not SMPL's by another family's rows.
SHIPPED = {
    "makehuman": (
        body(
            ("L", "R"),
            "root pelvis.* upperleg01.* upperleg02.* lowerleg01.* lowerleg02.* foot.* toe1-1.*",
            "root spine05 spine04 spine03 spine02 spine01 clavicle.* shoulder01.* upperarm01.* upperarm02.* "
            "lowerarm01.* lowerarm02.* wrist.* finger1-1.*",
            "spine01 neck01 neck02 neck03 head jaw",
        ),
        {"left_hip": "upperleg01.L", "right_wrist": "wrist.R", "neck": "neck01"},
    ),
    "unreal 5": (
        body(
            ("l", "r"),
            "root pelvis thigh_* calf_* foot_* ball_*",
            "pelvis spine_01 spine_02 spine_03 spine_04 spine_05 clavicle_* upperarm_* lowerarm_* hand_*",
            "spine_05 neck_01 neck_02 head",
        ),
        {"spine1": "spine_03", "neck": "neck_01", "head": "head"},
    ),
}


@pytest.mark.parametrize("name", SHIPPED)
def test_rigs_of_engines_are_known_without_a_map(name: str) -> None:
    skeleton, expected = SHIPPED[name]
    mapped = joint_map(skeleton, mk.SMPL22.name)
    assert mapped.family == name.split()[0] and not mapped.made_up
    for joint, own in expected.items():
        assert mapped.weights[mk.SMPL22.index(joint), skeleton.index(own)] == 1.0
    heights = (mapped.weights @ rest_positions(skeleton))[:, 1]
    spine = [heights[mk.SMPL22.index(joint)] for joint in ("pelvis", "spine1", "spine2", "spine3", "neck", "head")]
    assert spine == sorted(spine)


def test_an_unknown_skeleton_names_what_is_missing() -> None:
    rope = mk.Skeleton("rope", ("a", "b"), (-1, 0), np.zeros((2, 3), np.float32))
    with pytest.raises(SkeletonMapError, match="pelvis") as caught:
        joint_map(rope, "smpl22")
    again = copy.copy(caught.value)  # as pickle copies it between processes
    assert "left_knee" in again.missing and str(again) == str(caught.value)


def test_names_are_compared_without_namespace_prefix_and_case() -> None:
    rig = body(("Left", "Right"), "Hips *UpLeg *Leg *Foot", "Hips Spine *Arm *ForeArm *Hand", "Spine Neck Head")
    plain = joint_map(rig, "smpl22")
    for rename in ("mixamorig:{}", "Character1_{}", "RIG:{}"):
        renamed = replace(rig, joint_names=tuple(rename.format(name) for name in rig.joint_names))
        assert np.array_equal(joint_map(renamed, "smpl22").weights, plain.weights)
    assert plain.made_up == ("left_foot", "right_foot") and plain.family == "motionbuilder"


def test_made_up_toes_lie_ahead_of_the_ankles() -> None:
    names = tuple(name for name in mk.SMPL22.joint_names if name not in ("left_foot", "right_foot"))
    keep = [mk.SMPL22.index(name) for name in names]
    parents = tuple(names.index(mk.SMPL22.joint_names[mk.SMPL22.parents[joint]]) if joint else -1 for joint in keep)
    footless = mk.Skeleton("footless", names, parents, mk.SMPL22.offsets[keep])
    body = rest_positions(footless)
    body += np.array([0, 0.9, 0], np.float32)
    motion = mk.Motion(np.repeat(body[None], 2, axis=0), footless, TimeGrid(parse_fps(30), 2))
    toe = map_joints(motion, "smpl22")[:, mk.SMPL22.index("left_foot")] - body[names.index("left_ankle")]
    assert np.allclose(toe, (0.0, -0.14 * 0.4324, 0.33 * 0.4324), atol=1e-5)
    assert map_joints(motion, "kit21").shape == (2, 21, 3)


@pytest.mark.parametrize("source", ["cmu", "bandai-namco", "mixed-bvh"])
def test_every_real_skeleton_becomes_a_human_body(captures: Path, source: str) -> None:
    # `animated_drawings` holds cartoon-sized characters in no unit at all.
    items = [item for item in scan([captures / source]).items if "animated_drawings" not in item.sequence_id]
    for item in items[:: max(1, len(items) // 12)]:
        check_body(read(item, ReadOptions(fps=parse_fps(120))))


def test_hips_under_buttocks_are_mapped_and_drafted() -> None:
    """MocapNET's names: rhip hangs under rbuttock, and the knee is called so."""
    skeleton = body(
        ("l", "r"),
        "hip *buttock *hip *knee *foot",
        "hip abdomen chest *collar *shoulder *elbow *hand",
        "chest neck head",
    )
    weights = joint_map(skeleton, "smpl22").weights
    assert weights[mk.SMPL22.index("right_hip"), skeleton.index("rhip")] == 1
    assert 'right_knee = "rknee"' in draft_map(skeleton, "mine")
