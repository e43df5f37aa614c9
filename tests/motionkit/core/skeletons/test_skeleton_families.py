"""Skeleton maps given by a user: what is accepted, what is told, and that they change what they should."""

from pathlib import Path

import numpy as np
import pytest

from motionkit.core.errors import FormatError, MotionkitError
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.skeletons.families import (
    parse_layout_map,
    read_skeleton_map,
    shipped_families,
    with_layout_map,
)
from motionkit.core.skeletons.mapping import SkeletonMapError, joint_map, map_joints, rest_positions
from motionkit.io.npz import read_npz, write_npz
from motionkit.io.reading import read
from motionkit.io.registry import ReadOptions
from motionkit.io.scan import scan
from tests.helpers.format_samples import bvh_text
from tests.motionkit.core.skeletons.test_guessing import RIGS, body

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
    with pytest.raises(SkeletonMapError, match="--skeleton-map"):
        joint_map(plain.skeleton, "smpl22")
    layout_map = read_skeleton_map(write_map(tmp_path, robot_map()))
    motion = read(item, ReadOptions(skeleton_maps=(layout_map,)))
    assert motion.skeleton.layout_map == layout_map
    assert motion.skeleton != plain.skeleton and motion.skeleton.fingerprint != plain.skeleton.fingerprint
    body = map_joints(motion, "smpl22")
    names = motion.skeleton.joint_names
    assert np.allclose(body[:, SMPL22.index("left_wrist")], motion.joint_positions[:, names.index("L-gripper")])
    middle = motion.joint_positions[:, [names.index("torso_mid"), names.index("throat")]].mean(axis=1)
    assert np.allclose(body[:, SMPL22.index("spine3")], middle, atol=1e-6)
    mapping = joint_map(motion.skeleton, "smpl22")
    assert mapping.family == "robot" and not mapping.made_up and mapping.unmapped == ()
    assert map_joints(motion, "kit21").shape == (4, 21, 3)


def test_a_map_also_tells_which_axis_is_up(tmp_path: Path) -> None:
    # The same body along z: only a skeleton whose joints are known can be stood up.
    rows = []
    for line in robot_bvh().splitlines():
        words = line.split()
        turned = words and words[0] == "OFFSET"
        rows.append(f"OFFSET {words[1]} {-float(words[3])} {words[2]}" if turned else line)
    header, _, table = "\n".join(rows).partition("MOTION\n")
    lines = table.splitlines()
    for number in range(2, len(lines)):
        cells = lines[number].split()
        cells[1], cells[2] = str(-float(cells[2])), cells[1]
        cells[6:] = ["0"] * len(cells[6:])
        lines[number] = " ".join(cells)
    path = tmp_path / "z.bvh"
    path.write_text(header + "MOTION\n" + "\n".join(lines) + "\n")
    (item,) = scan([path]).items
    layout_map = read_skeleton_map(write_map(tmp_path, robot_map()))
    head = {}
    for name, maps in {"without": (), "with": (layout_map,)}.items():
        motion = read(item, ReadOptions(unit_metres=0.01, skeleton_maps=maps))
        head[name] = motion.joint_positions[0, motion.skeleton.index("skull")] - motion.joint_positions[0, 0]
    assert head["without"][2] > 0.5 > abs(head["without"][1])
    assert head["with"][1] > 0.5 > abs(head["with"][2])


def test_a_map_is_preferred_to_a_shipped_family_and_the_most_demanding_one_wins() -> None:
    general = '{"name":"general","requires":["pelvis"],"smpl22":' + rows_of_smpl22() + "}"
    special = '{"name":"special","requires":["pelvis","head"],"smpl22":' + rows_of_smpl22() + "}"
    other = '{"name":"other","requires":["tail"],"smpl22":' + rows_of_smpl22() + "}"
    skeleton = with_layout_map(SMPL22, (other, general, special))
    assert parse_layout_map(skeleton.layout_map).name == "special"
    assert joint_map(skeleton, "smpl22").family == "special"
    assert np.array_equal(joint_map(skeleton, "smpl22").weights, np.eye(22, dtype=np.float32))
    assert with_layout_map(skeleton, (general,)) is skeleton and with_layout_map(SMPL22, (other,)) is SMPL22
    assert skeleton != SMPL22 and with_layout_map(SMPL22, (special,)) == skeleton


def rows_of_smpl22() -> str:
    return "{" + ",".join(f'"{name}":"{name}"' for name in SMPL22.joint_names) + "}"


def test_toes_that_a_map_leaves_out_are_made_up(tmp_path: Path) -> None:
    text = robot_map(left_foot="", right_foot="")
    layout_map = read_skeleton_map(write_map(tmp_path, text))
    names = tuple(ROBOT.values())
    skeleton = Skeleton("robot", names, (-1, *([0] * (len(names) - 1))), np.zeros((len(names), 3), np.float32))
    assert joint_map(with_layout_map(skeleton, (layout_map,)), "smpl22").made_up == ("left_foot", "right_foot")


def test_a_map_that_names_joints_which_are_not_there_says_so(tmp_path: Path) -> None:
    layout_map = read_skeleton_map(write_map(tmp_path, robot_map(left_wrist='"L-hand"', neck='["gullet", "gorge"]')))
    names = tuple(ROBOT.values())
    skeleton = Skeleton("robot", names, (-1, *([0] * (len(names) - 1))), np.zeros((len(names), 3), np.float32))
    with pytest.raises(
        SkeletonMapError, match=r"its own map 'robot' names nothing for neck, left_wrist among"
    ) as caught:
        joint_map(with_layout_map(skeleton, (layout_map,)), "smpl22")
    assert caught.value.missing == ("neck", "left_wrist")


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
    with pytest.raises(FormatError, match="layout map of a skeleton cannot be read: name = None"):
        read_npz(tmp_path / "bad.npz")


def test_every_shipped_table_is_a_valid_map() -> None:
    families = shipped_families()
    assert {"smpl", "cmu", "motionbuilder", "deepmimic-humanoid3d"} <= {family.name for family in families}
    assert [len(family.requires) for family in families] == sorted(
        (len(family.requires) for family in families), reverse=True
    )


BAD = {
    'name = "robot"\nrequires = [': r"my-rig.toml, line 2: no TOML",
    robot_map() + 'tail = "sole"\n': r"'tail', which is no joint of the layout: pelvis, left_hip",
    robot_map(neck=""): r"says nothing about neck; only the feet",
    robot_map(spine1="{ base = 0.5, torso_mid = 0.6 }"): r"weights of spine1 sum to 1.1, expected 1",
    robot_map(spine1="{ base = nan }"): r"spine1 = ",
    robot_map(spine1="3"): r"spine1 = 3, expected a joint's name",
    robot_map(spine1='{ base = "half" }'): r"spine1 = ",
    robot_map(spine1="{ base = true }"): r"spine1 = ",
    robot_map().replace("requires", "require"): r"unknown key 'require', expected name",
    robot_map().replace('requires = ["base", "torso_mid", "skull"]\n', ""): r"requires is missing",
    robot_map().replace('["base", "torso_mid", "skull"]', "[]"): r"requires is missing",
    robot_map().replace('"robot"', '"smpl22"'): r"name = 'smpl22', expected a text other than",
    robot_map().replace("[smpl22]", "[kit21]"): r"unknown key 'kit21'",
    'name = "robot"\nrequires = ["base"]\n': r"no table \[smpl22\]",
    "units_per_metre = -1\n" + robot_map(): r"units_per_metre = -1, expected a positive number",
    "units_per_metre = " + "9" * 5000 + "\n" + robot_map(): r"no TOML",
    "source = 1979-05-27\n" + robot_map(): r"source is not a text",
    "aliases = { a = 1 }\n" + robot_map(): r"\[aliases\] holds lines",
}


@pytest.mark.parametrize("text", BAD)
def test_a_bad_map_says_what_to_mend(tmp_path: Path, text: str) -> None:
    with pytest.raises(FormatError, match=BAD[text]) as caught:
        read_skeleton_map(write_map(tmp_path, text))
    assert caught.value.reason == "skeleton-map"


def test_files_that_are_no_text_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "my-rig.toml"
    with pytest.raises(FormatError, match="cannot be read"):
        read_skeleton_map(path)
    path.write_bytes(b"name = '\xff'")
    with pytest.raises(FormatError, match="not UTF-8"):
        read_skeleton_map(path)
    path.write_bytes(b"\xef\xbb\xbf" + robot_map().replace("\n", "\r\n").encode())
    assert parse_layout_map(read_skeleton_map(path)).name == "robot"


@pytest.mark.parametrize("text", ["", "[1]", "{", "[" * 100_000])
def test_a_damaged_map_in_a_store_is_explained(text: str) -> None:
    with pytest.raises(MotionkitError, match="the layout map of a skeleton cannot be read"):
        parse_layout_map(text)


def test_spines_without_a_neck_or_a_second_joint() -> None:
    """Hips, Spine, Head and arms alone: the missing joints lie between the spine and the shoulders."""
    sides = [
        f"{side}{joint}" for side in ("Left", "Right") for joint in ("UpLeg", "Leg", "Foot", "Arm", "ForeArm", "Hand")
    ]
    names = ("Hips", "Spine", "Head", *sides)
    above = {"Spine": "Hips", "Head": "Spine", "UpLeg": "Hips", "Leg": "UpLeg", "Foot": "Leg", "Arm": "Spine"}
    above |= {"ForeArm": "Arm", "Hand": "ForeArm"}
    parents = [-1]
    for name in names[1:]:
        side = next((word for word in ("Left", "Right") if name.startswith(word)), "")
        parent = above[name.removeprefix(side)]
        parents.append(names.index(parent if parent in names else side + parent))
    offsets = np.zeros((len(names), 3), np.float32)
    offsets[1:] = (0.0, 0.2, 0.0)
    skeleton = Skeleton("short", names, tuple(parents), offsets)
    mapping = joint_map(skeleton, "smpl22")
    weights = dict(zip(SMPL22.joint_names, mapping.weights, strict=True))
    assert mapping.family == "motionbuilder" and set(mapping.made_up) == {"left_foot", "right_foot"}
    heights = [float(weights[name] @ np.arange(len(names), dtype=np.float32)) for name in ("pelvis", "head")]
    assert heights == [0.0, 2.0] and weights["neck"][names.index("LeftArm")] == 0.5
    assert all(np.isclose(weights[name].sum(), 1.0) for name in weights.keys() - set(mapping.made_up))


UE5 = body(
    ("l", "r"),
    "root pelvis thigh_* calf_* foot_* ball_*",
    "pelvis spine_01 spine_02 spine_03 spine_04 spine_05 clavicle_* upperarm_* lowerarm_* hand_*",
    "spine_05 neck_01 neck_02 head",
)
# What it is known as, and joints that are not SMPL's by another family's rows.
SHIPPED = {
    "makehuman": (RIGS["MakeHuman"][0], {"left_hip": "upperleg01.L", "right_wrist": "wrist.R", "neck": "neck01"}),
    "controlvae": (RIGS["ControlVAE"][0], {"left_shoulder": "lShoulder", "spine2": "lowerback_torso"}),
    "unreal": (RIGS["Unreal"][0], {"left_hip": "thigh_l", "right_elbow": "lowerarm_r", "left_foot": "ball_l"}),
    "unreal 5": (UE5, {"spine1": "spine_03", "neck": "neck_01", "head": "head"}),
}


@pytest.mark.parametrize("name", SHIPPED)
def test_rigs_of_engines_are_known_without_a_map(name: str) -> None:
    skeleton, expected = SHIPPED[name]
    mapped = joint_map(skeleton, SMPL22.name)
    assert mapped.family == name.split()[0] and not mapped.made_up
    for joint, own in expected.items():
        assert mapped.weights[SMPL22.index(joint), skeleton.index(own)] == 1.0
    heights = (mapped.weights @ rest_positions(skeleton))[:, 1]
    spine = [heights[SMPL22.index(joint)] for joint in ("pelvis", "spine1", "spine2", "spine3", "neck", "head")]
    assert spine == sorted(spine)
