"""Kimodo's files: SOMA's joints by their names, rotations that reproduce them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from motionkit.core import kinematics
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import map_joints
from motionkit.io.kimodo import SKELETONS, read_kimodo
from tests.helpers.refusal import refusal

FRAMES = 5


def written(path, num_joints, **more):
    """A body of random bones, moved by the published layout's forward kinematics: parent by parent, matrices."""
    random = np.random.default_rng(num_joints)
    parents = SKELETONS[num_joints].parents
    local = Rotation.from_rotvec(random.normal(0, 0.3, (FRAMES * num_joints, 3))).as_matrix()
    local = local.reshape(FRAMES, num_joints, 3, 3)
    offsets, root = random.normal(0, 0.2, (num_joints, 3)), random.normal(0, 1, (FRAMES, 3))
    rotations, positions = np.empty_like(local), np.empty((FRAMES, num_joints, 3))
    for joint, parent in enumerate(parents):
        rotations[:, joint] = local[:, joint] if parent < 0 else rotations[:, parent] @ local[:, joint]
        positions[:, joint] = root if parent < 0 else positions[:, parent] + rotations[:, parent] @ offsets[joint]
    arrays = {"posed_joints": positions, "global_rot_mats": rotations, "foot_contacts": np.zeros((FRAMES, 4)), **more}
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})
    return positions.astype(np.float32)


@pytest.mark.parametrize("num_joints", [22, 30, 77])
def test_positions_and_rotations(tmp_path, num_joints):
    positions = written(tmp_path / "a.npz", num_joints)
    motion = read_kimodo(tmp_path / "a.npz")
    assert motion.fps == 30
    np.testing.assert_array_equal(motion.joint_positions, positions)
    again = kinematics.forward_kinematics(motion.local_rotations, motion.root_translation, motion.skeleton)
    np.testing.assert_allclose(again, positions, atol=2e-6)


@pytest.mark.parametrize("num_joints", [30, 77])
def test_its_joints_are_the_22(tmp_path, num_joints):
    positions = written(tmp_path / "a.npz", num_joints)
    names = SKELETONS[num_joints].joint_names
    found = map_joints(read_kimodo(tmp_path / "a.npz"), "smpl22")
    for ours, theirs in {"left_hip": "LeftLeg", "right_knee": "RightShin", "left_wrist": "LeftHand"}.items():
        np.testing.assert_array_equal(found[:, SMPL22.index(ours)], positions[:, names.index(theirs)])
    assert names[:4] == ("Hips", "Spine1", "Spine2", "Chest") and names[-1].startswith("RightToe")


def test_rotations_of_another_body_are_left(tmp_path):
    positions = written(tmp_path / "a.npz", 30, global_rot_mats=np.tile(np.eye(3), (FRAMES, 30, 1, 1)))
    motion = read_kimodo(tmp_path / "a.npz")
    assert motion.local_rotations is None
    np.testing.assert_array_equal(motion.joint_positions, positions)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"posed_joints": np.zeros((FRAMES, 34, 3))}, "channel-count"),
        ({"posed_joints": np.full((FRAMES, 30, 3), np.inf)}, "nan"),
        ({"global_rot_mats": np.zeros((FRAMES, 29, 3, 3))}, "channel-count"),
    ],
)
def test_what_is_wrong_is_reported(tmp_path, changes, reason):
    written(tmp_path / "bad.npz", 30, **changes)
    assert refusal(read_kimodo, tmp_path / "bad.npz").reason == reason
