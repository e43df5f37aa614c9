from pathlib import Path

import numpy as np
import pytest

from motionkit.formats.registry import ReadOptions, read, scan
from motionkit.motion import Motion
from motionkit.skeleton import SMPL22, Skeleton
from motionkit.skeleton_map import SkeletonMapError, joint_map, map_joints
from motionkit.timegrid import parse_fps


def test_an_unknown_skeleton_names_what_is_missing() -> None:
    rope = Skeleton("rope", ("a", "b"), (-1, 0), np.zeros((2, 3), np.float32))
    with pytest.raises(SkeletonMapError, match="pelvis") as caught:
        joint_map(rope, "smpl22")
    assert "left_knee" in caught.value.missing


def test_weights_sum_to_one_and_the_layout_maps_to_itself() -> None:
    mapping = joint_map(SMPL22, "kit21")
    assert np.allclose(mapping.weights.sum(axis=1), 1.0)
    assert np.array_equal(joint_map(SMPL22, "smpl22").weights, np.eye(22, dtype=np.float32))


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
