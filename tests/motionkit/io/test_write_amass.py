"""SMPL-X's numbers out again: what our reader reads back, and what GMR's calls of `smplx` make of the file."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import smplx
import torch

import motionkit as mk
from motionkit.core.skeletons.mapping import rest_positions
from motionkit.fields.motion_field import to_motion
from motionkit.io.amass import write_amass as write
from motionkit.io.registry import ReadOptions
from motionkit.io.smpl_body import LAYOUTS, mean_shape_skeleton
from tests.helpers.amass_samples import stageii_fields, standing_poses, write_amass
from tests.helpers.analytic import analytic_motion
from tests.motionkit.io.test_amass import read_one
from tests.motionkit.io.test_body_models import write_body_model
from tests.motionkit.io.test_retargeting import directions


@pytest.mark.parametrize("models", [False, True])
def test_smpl_s_own_rotations_come_back_as_they_were(tmp_path: Path, models: bool) -> None:
    rng = np.random.default_rng(5)
    poses, trans = standing_poses(5, 165) + rng.normal(0, 0.4, (5, 165)), rng.normal(0, 1, (5, 3))
    fields = stageii_fields(5, poses=poses, trans=trans, mocap_frame_rate=np.array(59.94))
    write_amass(tmp_path / "in" / "a_stageii.npz", fields)
    options = ReadOptions()
    if models:
        write_body_model(tmp_path / "models" / "SMPLX_NEUTRAL.npz", LAYOUTS["smplx"], **standing_body(mean_rest()))
        options = ReadOptions(body_models=tmp_path / "models")
    motion = read_one(tmp_path / "in", options)
    (tmp_path / "out").mkdir()
    write(motion, tmp_path / "out" / "a.npz")
    with np.load(tmp_path / "out" / "a.npz", allow_pickle=False) as made:
        known = 165 if models else 66
        np.testing.assert_allclose(made["poses"][:, :known], poses[:, :known], atol=1e-5)
        assert not made["poses"][:, known:].any()
        np.testing.assert_allclose(made["trans"], trans, atol=1e-5)
        np.testing.assert_array_equal(made["pose_body"], made["poses"][:, 3:66])
        np.testing.assert_array_equal(made["pose_hand"], made["poses"][:, 75:])
        assert str(made["gender"]) == "neutral" and not made["betas"].any()
    again = read_one(tmp_path / "out", ReadOptions())
    assert again.fps == motion.fps == Fraction(60000, 1001)


def mean_rest() -> np.ndarray:
    """Where 55 joints of an upright body rest; what hangs on wrists and head is anywhere."""
    places = np.random.default_rng(1).normal(0, 0.2, (55, 3))
    places[:22] = rest_positions(mean_shape_skeleton())
    return places


def standing_body(places: np.ndarray) -> dict[str, object]:
    """The arrays of a body model whose first vertices are its joints."""
    vertices = np.zeros((10475, 3))
    vertices[:55] = places
    unmoved = np.zeros((10475, 3, 400), np.float32)
    return {"v_template": vertices, "J_regressor": np.eye(55, 10475, dtype=np.float32), "shapedirs": unmoved}


def test_gmr_s_calls_of_smplx_put_the_joints_where_the_motion_has_them(tmp_path: Path) -> None:
    walk = to_motion(analytic_motion("walk", 2.0), Fraction(120))
    write(walk, tmp_path / "walk.npz")
    path = tmp_path / "models" / "smplx" / "SMPLX_NEUTRAL.npz"
    write_body_model(path, LAYOUTS["smplx"], **standing_body(mean_rest()))
    # general_motion_retargeting/utils/smpl.py, load_smplx_file
    data = np.load(tmp_path / "walk.npz", allow_pickle=True)
    count = len(data["pose_body"])
    model = smplx.create(
        str(tmp_path / "models"), "smplx", gender=str(data["gender"]), use_pca=False, ext="npz", flat_hand_mean=True
    )
    posed = model(
        betas=torch.tensor(data["betas"]).float().view(1, -1),
        global_orient=torch.tensor(data["root_orient"]).float(),
        body_pose=torch.tensor(data["pose_body"]).float(),
        transl=torch.tensor(data["trans"]).float(),
        left_hand_pose=torch.zeros(count, 45),
        right_hand_pose=torch.zeros(count, 45),
        jaw_pose=torch.zeros(count, 3),
        leye_pose=torch.zeros(count, 3),
        reye_pose=torch.zeros(count, 3),
        expression=torch.zeros(count, 10),
    )
    x, y, z = np.moveaxis(posed.joints[:, :22].detach().numpy(), -1, 0)
    again = mk.read(tmp_path / "walk.npz")
    np.testing.assert_allclose(np.stack((x, z, -y), axis=-1), again.joint_positions, atol=1e-4)
    np.testing.assert_allclose(directions(again), directions(walk), atol=1e-3)
