from pathlib import Path

import numpy as np
import pytest

from motionkit.core.framerate import parse_fps
from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.skeletons.mapping import SkeletonMapError, joint_map, map_joints, rest_positions
from motionkit.core.timegrid import TimeGrid
from motionkit.io.reading import read
from motionkit.io.registry import ReadOptions
from motionkit.io.scan import scan


def test_an_unknown_skeleton_names_what_is_missing() -> None:
    rope = Skeleton("rope", ("a", "b"), (-1, 0), np.zeros((2, 3), np.float32))
    with pytest.raises(SkeletonMapError, match="pelvis") as caught:
        joint_map(rope, "smpl22")
    assert "left_knee" in caught.value.missing


def test_weights_sum_to_one_and_the_layout_maps_to_itself() -> None:
    mapping = joint_map(SMPL22, "kit21")
    assert np.allclose(mapping.weights.sum(axis=1), 1.0)
    assert np.array_equal(joint_map(SMPL22, "smpl22").weights, np.eye(22, dtype=np.float32))


def test_names_are_compared_without_namespace_prefix_and_case() -> None:
    names = ("Hips", "LeftUpLeg", "LeftLeg", "LeftFoot", "RightUpLeg", "RightLeg", "RightFoot", "Spine", "Neck", "Head")
    names += ("LeftArm", "LeftForeArm", "LeftHand", "RightArm", "RightForeArm", "RightHand")
    parents = (-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 7, 10, 11, 7, 13, 14)
    offsets = np.zeros((16, 3), np.float32)
    plain = joint_map(Skeleton("plain", names, parents, offsets), "smpl22")
    for rename in ("mixamorig:{}", "Character1_{}", "rig:{}"):
        renamed = Skeleton("other", tuple(rename.format(name) for name in names), parents, offsets)
        assert np.array_equal(joint_map(renamed, "smpl22").weights, plain.weights)
    assert plain.made_up == ("left_foot", "right_foot") and plain.family == "motionbuilder"


def test_errors_travel_between_processes() -> None:
    rope = Skeleton("rope", ("a", "b"), (-1, 0), np.zeros((2, 3), np.float32))
    error = SkeletonMapError(rope, "smpl22", ("pelvis",))
    rebuild, arguments = error.__reduce__()  # what pickle calls
    again = rebuild(*arguments)  # type: ignore[operator, misc]
    assert str(again) == str(error) and again.missing == ("pelvis",)


def test_made_up_toes_lie_ahead_of_the_ankles() -> None:
    names = tuple(name for name in SMPL22.joint_names if name not in ("left_foot", "right_foot"))
    keep = [SMPL22.index(name) for name in names]
    parents = tuple(names.index(SMPL22.joint_names[SMPL22.parents[joint]]) if joint else -1 for joint in keep)
    footless = Skeleton("footless", names, parents, SMPL22.offsets[keep])
    body = rest_positions(footless)
    body += np.array([0, 0.9, 0], np.float32)
    motion = Motion(np.repeat(body[None], 2, axis=0), footless, TimeGrid(parse_fps(30), 2))
    toe = map_joints(motion, "smpl22")[:, SMPL22.index("left_foot")] - body[names.index("left_ankle")]
    assert np.allclose(toe, (0.0, -0.14 * 0.4324, 0.33 * 0.4324), atol=1e-5)
    assert map_joints(motion, "kit21").shape == (2, 21, 3)


def test_a_tip_stands_in_for_a_toe(captures: Path) -> None:
    (item,) = scan([captures / "mixed-bvh" / "bvh_toolbox" / "test_mocapbank.bvh"]).items
    motion = read(item)
    mapping = joint_map(motion.skeleton, "smpl22")
    assert not mapping.made_up and mapping.tip_weights[SMPL22.index("left_foot")].any()
    body = map_joints(motion, "smpl22")
    tip = dict(motion.skeleton.end_sites)[motion.skeleton.index("LeftAnkle")]
    assert bone(body, "left_ankle", "left_foot") == pytest.approx(float(np.linalg.norm(tip)), abs=1e-4)


def test_a_body_that_faces_z_has_its_left_at_positive_x(captures: Path) -> None:
    # Subject 07 walks along +z from the first frame on.
    items = {item.key or item.path.stem: item for item in scan([captures / "cmu" / "asfamc" / "07"]).items}
    motion = read(items["07_01"], ReadOptions(fps=parse_fps(120)))
    body = map_joints(motion, "smpl22")
    path = body[-1, 0] - body[0, 0]
    assert abs(path[2]) > 5 * abs(path[0])
    sign = np.sign(path[2])
    across = body[:, SMPL22.index("left_shoulder")] - body[:, SMPL22.index("right_shoulder")]
    assert (np.sign(across[:, 0]) == sign).all()
    assert 1.35 < np.median(body[:, SMPL22.index("head"), 1]) < 1.75


def bone(body: np.ndarray, one: str, other: str) -> float:
    return float(np.linalg.norm(body[:, SMPL22.index(one)] - body[:, SMPL22.index(other)], axis=-1).mean())


@pytest.mark.parametrize("source", ["cmu", "bandai-namco", "mixed-bvh"])
def test_every_real_skeleton_becomes_a_human_body(captures: Path, source: str) -> None:
    # `animated_drawings` holds cartoon-sized characters in no unit at all.
    items = [item for item in scan([captures / source]).items if "animated_drawings" not in item.sequence_id]
    step = max(1, len(items) // 40)
    for item in items[::step]:
        motion = read(item, ReadOptions(fps=parse_fps(120)))
        check_body(motion)


def check_body(motion: Motion) -> None:
    body = map_joints(motion, "smpl22")
    for side in ("left", "right"):
        assert 0.34 < bone(body, f"{side}_hip", f"{side}_knee") < 0.52, motion
        assert 0.36 < bone(body, f"{side}_knee", f"{side}_ankle") < 0.50, motion
        assert 0.22 < bone(body, f"{side}_shoulder", f"{side}_elbow") < 0.35, motion
        assert 0.19 < bone(body, f"{side}_elbow", f"{side}_wrist") < 0.32, motion
        assert 0.08 < bone(body, f"{side}_ankle", f"{side}_foot") < 0.22, motion
    assert 0.15 < bone(body, "left_shoulder", "right_shoulder") < 0.45
    assert 0.10 < bone(body, "left_hip", "right_hip") < 0.25
    assert (
        1.15
        < bone(body, "left_hip", "left_knee") + bone(body, "left_knee", "left_ankle") + bone(body, "pelvis", "head")
        < 1.7
    )
    # Forward is where the toes point; seen from there, +x of the body is its left.
    across = body[:, SMPL22.index("left_hip")] - body[:, SMPL22.index("right_hip")]
    up = body[:, SMPL22.index("neck")] - body[:, SMPL22.index("pelvis")]
    toes = body[:, SMPL22.index("left_foot")] - body[:, SMPL22.index("left_ankle")]
    assert np.median(np.sum(np.cross(across, up) * toes, axis=-1)) > 0, motion
    assert map_joints(motion, "kit21").shape[1] == 21
