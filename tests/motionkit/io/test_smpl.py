"""SMPL's parameters as a dictionary, Motion-X's rows: the same body as AMASS's file of the same poses."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from motionkit.core.errors import FormatError
from motionkit.io.registry import ReadOptions
from motionkit.io.scan import read, scan
from motionkit.io.smpl import read_motion_x, read_smpl
from tests.helpers.amass_samples import smplh_fields, write_amass

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


def test_one_body_of_a_batch(tmp_path, poses, expected):
    joints, places = poses
    np.savez(tmp_path / "one.npz", **{key: value[None] for key, value in dictionary(joints, places).items()}, fps=30)
    motion = read_smpl(tmp_path / "one.npz")
    np.testing.assert_allclose(motion.local_rotations, expected.local_rotations[:, :22], atol=1e-5)


def test_three_frames_of_vectors_are_no_matrix(tmp_path, poses, expected):
    joints, places = poses
    arrays = {name: values[:3] for name, values in dictionary(joints, places).items()}
    np.savez(tmp_path / "short.npz", **arrays, fps=30)
    motion = read_smpl(tmp_path / "short.npz")
    np.testing.assert_allclose(motion.joint_positions, expected.joint_positions[:3], atol=2e-6)


def test_a_camera_s_view_is_turned_upright(tmp_path, poses, expected):
    """From z up to y up and on to y down, as images have it: the same body again."""
    joints, places = poses
    down = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0])) * Rotation.from_euler("x", -np.pi / 2)
    turned = joints.copy()
    turned[:, 0] = (down * Rotation.from_rotvec(joints[:, 0])).as_rotvec()
    pelvis = read_smpl_offset(tmp_path, poses)
    moved = down.apply(places + pelvis) - pelvis
    np.savez(tmp_path / "camera.npz", **dictionary(turned, moved, fps=24))
    motion = read_smpl(tmp_path / "camera.npz")
    assert any("y down" in line for line in motion.provenance.operations)
    np.testing.assert_allclose(motion.joint_positions, expected.joint_positions, atol=2e-6)


def read_smpl_offset(tmp_path, poses):
    np.savez(tmp_path / "any.npz", **dictionary(*poses, fps=24))
    return read_smpl(tmp_path / "any.npz").skeleton.offsets[0]


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
    ("changes", "reason", "message"),
    [
        ({"fps": None}, "no-framerate", "--fps"),
        ({"fps": -3}, "framerate", "fps"),
        ({"body_pose": np.zeros((FRAMES, 60))}, "channel-count", "21 joints, expected 22 or 24"),
        ({"body_pose": np.full((FRAMES, 63), 90.0)}, "radians", "degrees"),
        ({"body_pose": np.zeros((FRAMES, 21, 3, 3))}, "range", "rotation matrices"),
        ({"body_pose": np.full((FRAMES, 63), np.nan)}, "nan", "body_pose"),
        ({"transl": np.zeros((FRAMES + 1, 3))}, "channel-count", "transl"),
        ({"global_orient": np.zeros((FRAMES, 6))}, "channel-count", "global_orient"),
        ({"body_pose": np.zeros((FRAMES + 1, 63))}, "channel-count", "frames"),
        ({"body_pose": np.float64(0.0)}, "channel-count", "body_pose: a single number"),
        ({"betas": np.float64(0.0)}, "channel-count", "betas: a single number"),
        ({"body_pose": np.array([{}], object)}, "object-array", "Python objects"),
    ],
)
def test_what_is_wrong_is_reported_in_one_line(tmp_path, poses, changes, reason, message):
    arrays = {**dictionary(*poses, fps=30), **changes}
    np.savez(tmp_path / "bad.npz", **{name: value for name, value in arrays.items() if value is not None})
    with pytest.raises(FormatError, match=message) as told:
        read_smpl(tmp_path / "bad.npz")
    assert told.value.reason == reason and "\n" not in str(told.value)
