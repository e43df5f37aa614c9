"""SMPL's parameters as a dictionary, Motion-X's rows, Kimodo's files: positions and rotations that are known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from motionkit.core import kinematics
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import map_joints
from motionkit.io.kimodo import SKELETONS, read_kimodo
from motionkit.io.registry import ReadOptions
from motionkit.io.scan import read, scan
from motionkit.io.smpl import read_motion_x, read_smpl
from tests.helpers.amass_samples import smplh_fields, write_amass
from tests.helpers.refusal import refusal

FRAMES = 6


@pytest.fixture
def poses():
    """Poses about a body that stands along z, as AMASS has them: root, 21 joints; and where the body is."""
    random = np.random.default_rng(0)
    joints = random.normal(0, 0.2, (FRAMES, 22, 3))
    joints[:, 0] = (
        Rotation.from_euler("z", np.linspace(0, 1, FRAMES)[:, None]) * Rotation.from_euler("x", np.pi / 2)
    ).as_rotvec()
    return joints, random.normal(0, 1, (FRAMES, 3))


@pytest.fixture
def expected(tmp_path, poses):
    joints, places = poses
    full = np.concatenate((joints.reshape(FRAMES, 66), np.zeros((FRAMES, 90))), axis=1)
    fields = smplh_fields(num_frames=FRAMES) | {"poses": full, "trans": places}
    path = write_amass(tmp_path / "take_poses.npz", fields)
    (item,) = scan([path]).items
    return read(item, ReadOptions())


def dictionary(joints, places, **more):
    return {"global_orient": joints[:, 0], "body_pose": joints[:, 1:].reshape(FRAMES, 63), "transl": places, **more}


def test_vectors_and_matrices_are_the_body_of_amass(tmp_path, poses, expected):
    joints, places = poses
    matrices = Rotation.from_rotvec(joints.reshape(-1, 3)).as_matrix().reshape(FRAMES, 22, 3, 3)
    smpl = np.concatenate((joints, np.zeros((FRAMES, 2, 3))), axis=1)
    forms = {
        "vectors": dictionary(joints, places),
        "joints": {**dictionary(joints, places), "global_orient": joints[:, :1], "body_pose": joints[:, 1:]},
        "one of a batch": {key: value[None] for key, value in dictionary(joints, places).items()},
        "matrices": {"global_orient": matrices[:, :1], "body_pose": matrices[:, 1:], "transl": places},
        "world": {"pose_world": smpl.reshape(FRAMES, 72), "trans_world": places},
    }
    for name, arrays in forms.items():
        np.savez(tmp_path / f"{name}.npz", **arrays, fps=30)
        (item,) = scan([tmp_path / f"{name}.npz"]).items
        assert item.format == "smpl"
        motion = read(item, ReadOptions())
        assert motion.fps == 30 and motion.local_rotations is not None
        np.testing.assert_allclose(motion.joint_positions, expected.joint_positions, atol=2e-6, err_msg=name)


def test_a_camera_s_view_is_turned_upright(tmp_path, poses, expected):
    """From z up to y up and on to y down, as images have it: the same body again."""
    joints, places = poses
    down = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0])) * Rotation.from_euler("x", -np.pi / 2)
    turned = joints.copy()
    turned[:, 0] = (down * Rotation.from_rotvec(joints[:, 0])).as_rotvec()
    np.savez(tmp_path / "any.npz", **dictionary(*poses, fps=24))
    pelvis = read_smpl(tmp_path / "any.npz").skeleton.offsets[0]
    moved = down.apply(places + pelvis) - pelvis
    np.savez(tmp_path / "camera.npz", **dictionary(turned, moved, fps=24))
    motion = read_smpl(tmp_path / "camera.npz")
    np.testing.assert_allclose(motion.joint_positions, expected.joint_positions, atol=2e-6)


def test_rows_of_motion_x(tmp_path, poses, expected):
    joints, places = poses
    rows = np.random.default_rng(1).normal(0, 1, (FRAMES, 322))
    rows[:, :66], rows[:, 309:312] = joints.reshape(FRAMES, 66), places
    np.save(tmp_path / "clip1.npy", rows.astype(np.float32))
    (item,) = scan([tmp_path / "clip1.npy"]).items
    assert item.format == "motion-x"
    motion = read_motion_x(tmp_path / "clip1.npy")
    assert motion.fps == 30
    np.testing.assert_allclose(motion.joint_positions, expected.joint_positions, atol=2e-6)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"fps": None}, "no-framerate"),
        ({"fps": -3}, "framerate"),
        ({"body_pose": np.zeros((FRAMES, 60))}, "channel-count"),
        ({"body_pose": np.full((FRAMES, 63), 90.0)}, "radians"),
        ({"body_pose": np.zeros((FRAMES, 21, 3, 3))}, "range"),
        ({"body_pose": np.full((FRAMES, 63), np.nan)}, "nan"),
        ({"transl": np.zeros((FRAMES + 1, 3))}, "channel-count"),
        ({"betas": np.float64(0.0)}, "channel-count"),
        ({"body_pose": np.array([{}], object)}, "object-array"),
    ],
)
def test_what_is_wrong_is_reported(tmp_path, poses, changes, reason):
    arrays = {**dictionary(*poses, fps=30), **changes}
    np.savez(tmp_path / "bad.npz", **{name: value for name, value in arrays.items() if value is not None})
    assert refusal(read_smpl, tmp_path / "bad.npz").reason == reason


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
    arrays = {
        "posed_joints": positions,
        "global_rot_mats": rotations,
        "foot_contacts": np.zeros((FRAMES, 4)),
        **more,
    }
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
def test_bad_files_of_kimodo_are_refused(tmp_path, changes, reason):
    written(tmp_path / "bad.npz", 30, **changes)
    assert refusal(read_kimodo, tmp_path / "bad.npz").reason == reason
