"""EasyMocap's folders of JSON frames, made from motions that are known."""

import json
from fractions import Fraction
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from motionkit.core import kinematics
from motionkit.core.skeletons.mapping import map_joints
from motionkit.io.easymocap import BODY_25
from motionkit.io.registry import ReadOptions
from motionkit.io.scan import read, scan
from motionkit.io.smpl_body import mean_shape_skeleton
from tests.helpers.refusal import refusal
from tests.helpers.vector_samples import walk

AT_25 = ReadOptions(fps=Fraction(25))


def _write(folder: Path, frames: list[list[dict[str, object]]]) -> Path:
    folder.mkdir()
    for number, persons in enumerate(frames):
        (folder / f"{number:06d}.json").write_text(json.dumps(persons))
    return folder


def test_a_fit_of_smpl_turns_about_the_origin(tmp_path: Path) -> None:
    motion, rest = walk(), mean_shape_skeleton()
    assert motion.local_rotations is not None
    turns = [Rotation.from_quat(quaternions, scalar_first=True) for quaternions in motion.local_rotations]
    frames = []
    for frame, turn in enumerate(turns):
        vectors = turn.as_rotvec()
        person = {"id": 1, "Rh": [vectors[0].tolist()], "Th": [[0.02 * frame, 0.0, 0.0]], "shapes": [[0.0] * 10]}
        frames.append([person | {"poses": [[0.0] * 3 + vectors[1:].ravel().tolist() + [0.0] * 6]}])
    items = scan([_write(tmp_path / "smpl", frames)]).items
    assert [item.key for item in items] == ["1"]
    assert refusal(read, items[0]).reason == "no-framerate"
    found = read(items[0], AT_25)
    root = [turn[0].apply(rest.offsets[0]) + np.array([0.02 * frame, 0, 0]) for frame, turn in enumerate(turns)]
    expected = kinematics.forward_kinematics(motion.local_rotations, np.array(root), rest)
    np.testing.assert_allclose(found.joint_positions, expected, atol=1e-5)


def test_points_of_two_persons(tmp_path: Path) -> None:
    joints = walk().joint_positions[:20]
    places = {"Nose": 15, "Neck": 12, "RShoulder": 17, "RElbow": 19, "RWrist": 21, "LShoulder": 16, "LElbow": 18}
    places |= {"LWrist": 20, "RHip": 2, "RKnee": 5, "RAnkle": 8, "LHip": 1, "LKnee": 4, "LAnkle": 7}
    order = [places.get(name, 0) for name in BODY_25]
    points = joints[:, order][..., [0, 2, 1]] * [1, -1, 1]  # z up
    frames = [
        [
            {"id": 0, "keypoints3d": np.c_[pose, np.ones(25)].tolist()},
            {"id": 7, "keypoints3d": np.c_[pose + np.array([2, 0, 0]), np.ones(25)].tolist()},
        ]
        for pose in points
    ]
    frames[3][0]["keypoints3d"][4] = [0.0, 0.0, 0.0, 0.0]
    first, second = (read(item, AT_25) for item in scan([_write(tmp_path / "keypoints3d", frames)]).items)
    mean = (joints[2, 21] + joints[4, 21]) / 2
    np.testing.assert_allclose(first.joint_positions[3, BODY_25.index("RWrist")], mean, atol=1e-5)
    np.testing.assert_allclose(second.joint_positions, joints[:, order] + [2, 0, 0], atol=1e-5)
    np.testing.assert_allclose(map_joints(first, "smpl22")[:, 5], joints[:, 5], atol=1e-5)
    (tmp_path / "keypoints3d" / "000009.json").write_text("[{")
    (problem,) = scan([tmp_path / "keypoints3d"]).problems
    assert problem.path.name == "000009.json"
