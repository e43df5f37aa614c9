from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from motionkit.core.errors import UsageError
from motionkit.features import field, humanml3d
from motionkit.features.layout import LAYOUTS, PoseLayout
from tests.motionkit.features.test_vectors import analytic_motion


def wandering_body(name: str, num_frames: int = 101) -> np.ndarray:
    return analytic_motion(Fraction(20), name)[:num_frames]


def shortest(u: np.ndarray, v: np.ndarray) -> Rotation:
    axis = np.cross(u, v)
    angle = np.arctan2(np.linalg.norm(axis), np.dot(u, v))
    return Rotation.from_rotvec(axis / (np.linalg.norm(axis) or 1.0) * angle)


def plain_vectors(joints: np.ndarray, body: PoseLayout) -> np.ndarray:
    """The published pose vector written out plainly, one frame and one bone at a time, with scipy's rotations."""
    joints = joints.astype(np.float64)
    (right_hip, left_hip), (right_shoulder, left_shoulder) = body.lateral_joints
    forward = []
    for pose in joints:
        across = (pose[left_hip] - pose[right_hip]) + (pose[right_shoulder] - pose[left_shoulder])
        forward.append(np.cross([0, 1, 0], across / np.linalg.norm(across)))
    smooth = gaussian_filter1d(np.array(forward), 20, axis=0, mode="nearest")
    heading = [shortest(direction / np.linalg.norm(direction), np.array([0.0, 0, 1])) for direction in smooth]
    heading[0] = Rotation.identity()
    rows = []
    for t in range(len(joints) - 1):
        between = (heading[t + 1] * heading[t].inv()).as_quat()  # of any sign, as published
        step = joints[t + 1] - joints[t]
        root_step = heading[t + 1].apply(step[0])
        relative = heading[t].apply(joints[t] - joints[t, 0] * [1, 0, 1])
        rotations = np.zeros((body.num_joints, 6))
        for chain in body.chains:
            above = heading[t]
            for start, end in pairwise(chain):
                world = shortest(np.array(body.bone_directions[end], float), joints[t, end] - joints[t, start])
                local = (above.inv() * world).as_matrix()
                rotations[end] = np.concatenate((local[:, 0], local[:, 1]))
                above = world
        contacts = [float(np.sum(step[foot] ** 2) < body.contact_threshold) for foot in body.contact_joints]
        rows.append(
            np.concatenate(
                (
                    [np.arcsin(between[1]), root_step[0], root_step[2], joints[t, 0, 1]],
                    relative[1:].ravel(),
                    rotations[1:].ravel(),
                    heading[t].apply(step).ravel(),
                    contacts,
                )
            )
        )
    return np.array(rows)


@pytest.mark.parametrize(("name", "num_frames"), [("smpl22", 2), ("smpl22", 101), ("kit21", 40)])
def test_agrees_with_the_plain_reference(name: str, num_frames: int) -> None:
    joints = wandering_body(name, num_frames)
    found = humanml3d.vectors(joints, name)
    assert found.shape == (num_frames - 1, LAYOUTS[name].vector.size)
    assert np.allclose(found, plain_vectors(joints, LAYOUTS[name]), atol=2e-5)


def test_published_clip(golden_humanml3d: Path) -> None:
    published = np.load(golden_humanml3d / "new_joint_vecs" / "012314.npy")
    joints = np.load(golden_humanml3d / "new_joints" / "012314.npy")
    found = humanml3d.vectors(joints, "smpl22")
    # The published vectors came from one more pose than the published joints hold, and smoothing looks 80 frames ahead.
    whole = len(found) - 80  # rows that do not look beyond the end, by the smoothing
    assert np.abs(found - published[: len(found)])[:whole].max() <= 1e-5
    assert np.array_equal(found[:, 259:], published[: len(found), 259:])
    assert np.abs(humanml3d.positions(published, "smpl22") - joints).max() < 1e-6


@pytest.mark.parametrize("name", list(LAYOUTS))
def test_positions_come_back(name: str) -> None:
    joints = humanml3d.process(wandering_body(name, 50), name)  # headings beyond ±π are folded back
    assert np.allclose(humanml3d.positions(humanml3d.vectors(joints, name), name), joints[:-1], atol=2e-5)


@pytest.mark.parametrize("name", list(LAYOUTS))
def test_processing_leaves_one_skeleton_on_the_floor_at_the_origin_facing_z(name: str) -> None:
    raw = wandering_body(name, 30)
    target = 1.3 * humanml3d.standard_bone_lengths(name)
    joints = humanml3d.process(raw, name, target)
    for pose in joints[[0, 17]]:
        assert np.allclose(humanml3d.bone_lengths(pose, name), target, atol=1e-5)
    assert joints[..., 1].min() == pytest.approx(0, abs=1e-6)
    assert np.allclose(joints[0, 0, [0, 2]], 0, atol=1e-6)
    assert field.heading(joints[0]) == pytest.approx(0, abs=1e-5)


def test_degenerate_bones_give_finite_rotations() -> None:
    joints = wandering_body("smpl22", 5)
    joints[:, 15] = joints[:, 12]
    joints[:, 6] = joints[:, 3] - np.array([0, 0.1, 0], np.float32)
    found = humanml3d.vectors(joints, "smpl22")
    columns = found[:, 67:193].reshape(4, 21, 2, 3)
    assert np.allclose(np.linalg.norm(columns, axis=-1), 1, atol=1e-4)
    assert np.allclose(np.sum(columns[:, :, 0] * columns[:, :, 1], axis=-1), 0, atol=1e-4)


def test_wrong_shapes_and_names_are_refused() -> None:
    joints = np.zeros((9, 21, 3), np.float32)
    with pytest.raises(ValueError, match="22"):
        humanml3d.vectors(joints, "smpl22")
    with pytest.raises(UsageError, match="'smplx'"):
        humanml3d.vectors(joints, "smplx")
    with pytest.raises(ValueError, match="251"):
        humanml3d.positions(np.zeros((9, 251), np.float32), "smpl22")
