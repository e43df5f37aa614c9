"""Joints from synthetic body models in the published layouts, against the `smplx` package."""

from pathlib import Path

import numpy as np
import pytest
import smplx
import torch

from motionkit.core.errors import FormatError
from motionkit.core.skeleton import SMPL22
from motionkit.io.registry import ReadOptions
from motionkit.io.scan import read, scan
from motionkit.io.smpl_body import LAYOUTS, PoseLayout, find_body_model
from tests.helpers.amass_samples import smplh_fields, stageii_fields, write_amass
from tests.helpers.refusal import refusal
from tests.motionkit.io.test_amass import read_one

NUM_VERTICES = {"smplh": 6890, "smplx": 10475}
NUM_DIRECTIONS = {"smplh": 300, "smplx": 400}


def write_body_model(path: Path, layout: PoseLayout, seed: int = 0, **changes: object) -> Path:
    """A body of random vertices that has what `smplx` asks for; its joints are means of a few vertices."""
    rng = np.random.default_rng(seed)
    vertices, joints = NUM_VERTICES.get(layout.family, 40), layout.num_joints
    regressor = np.zeros((joints, vertices), np.float32)
    for row in regressor:
        row[rng.choice(vertices, 6, replace=False)] = 1 / 6
    fields: dict[str, object] = {
        "v_template": rng.normal(0, 0.5, (vertices, 3)),
        "shapedirs": rng.normal(0, 0.05, (vertices, 3, NUM_DIRECTIONS.get(layout.family, 10))).astype(np.float32),
        "J_regressor": regressor,
        "kintree_table": np.stack((np.array([2**32 - 1, *layout.parents[1:]]), np.arange(joints))).astype(np.uint32),
        "f": np.zeros((1, 3), np.uint32),
        "posedirs": np.zeros((vertices, 3, 9 * (joints - 1)), np.float16),
        "weights": np.full((vertices, joints), 1 / joints, np.float32),
        "lmk_faces_idx": np.zeros(51, np.int64),
        "lmk_bary_coords": np.zeros((51, 3)),
    }
    for side in "lr":
        fields |= {f"hands_mean{side}": np.zeros(45), f"hands_components{side}": np.eye(45)}
    return write_amass(path, fields | changes)


@pytest.mark.parametrize(
    ("family", "name"), [("smplh", "smplh/female/model.npz"), ("smplx", "models/SMPLX_NEUTRAL.npz")]
)
def test_joints_are_those_of_the_smplx_package(tmp_path: Path, family: str, name: str) -> None:
    layout = LAYOUTS[family]
    path = write_body_model(tmp_path / name, layout)
    rng = np.random.default_rng(5)
    poses, trans = rng.normal(0, 0.4, (3, 3 * layout.num_joints)), rng.normal(0, 1, (3, 3))
    fields = smplh_fields(3) if family == "smplh" else stageii_fields(3)
    write_amass(tmp_path / "amass" / "a_poses.npz", fields | {"poses": poses, "trans": trans})
    folder = tmp_path if family == "smplh" else tmp_path / "models"
    motion = read_one(tmp_path / "amass", ReadOptions(body_models=folder))

    betas = torch.tensor(np.tile(np.linspace(-1, 1, 16), (3, 1)), dtype=torch.float32)
    parts = {"global_orient": (0, 3), "body_pose": (3, 66)}
    hands = 75 if family == "smplx" else 66
    parts |= {"left_hand_pose": (hands, hands + 45), "right_hand_pose": (hands + 45, hands + 90)}
    if family == "smplx":
        parts |= {"jaw_pose": (66, 69), "leye_pose": (69, 72), "reye_pose": (72, 75)}
    model = (smplx.SMPLHLayer if family == "smplh" else smplx.SMPLXLayer)(
        str(path), ext="npz", num_betas=16, flat_hand_mean=True, batch_size=3
    )
    turns = torch.tensor(poses, dtype=torch.float32)
    matrices = {key: _matrices(turns[:, start:stop]) for key, (start, stop) in parts.items()}
    posed = model(betas=betas, transl=torch.tensor(trans, dtype=torch.float32), **matrices)
    x, y, z = np.moveaxis(posed.joints[:, : layout.num_joints].detach().numpy(), -1, 0)
    assert np.abs(motion.joint_positions - np.stack((x, z, -y), axis=-1)).max() < 1e-5
    assert motion.skeleton.joint_names == layout.joint_names


def _matrices(vectors: torch.Tensor) -> torch.Tensor:
    joints = vectors.shape[1] // 3
    return smplx.lbs.batch_rodrigues(vectors.reshape(-1, 3)).reshape(-1, joints, 3, 3)


@pytest.mark.parametrize(
    ("gender", "expected"),
    [
        ("male", "male"),
        ("b'male'", "male"),
        (np.array(b"male", dtype=object), "male"),
        ("female", "neutral"),
        (None, "neutral"),
    ],
)
def test_the_model_is_the_gender_s_or_neutral(tmp_path: Path, gender: object, expected: str) -> None:
    layout = LAYOUTS["smpl"]
    write_body_model(tmp_path / "models" / "smpl" / "SMPL_MALE.npz", layout, 1)
    write_body_model(tmp_path / "models" / "smpl" / "SMPL_NEUTRAL.npz", layout, 2)
    write_amass(tmp_path / "amass" / "a_poses.npz", smplh_fields(width=72, gender=gender))
    motion = read_one(tmp_path / "amass", ReadOptions(body_models=tmp_path / "models"))
    assert motion.skeleton.name == f"smpl-{expected}" and motion.skeleton.num_joints == 24


def test_betas_of_any_form_and_none(tmp_path: Path) -> None:
    layout = LAYOUTS["smpl"]
    write_body_model(tmp_path / "models" / "SMPL_FEMALE.npz", layout)
    model = find_body_model(tmp_path / "models", layout, "female")
    betas = np.linspace(-1, 1, 16)
    options = ReadOptions(body_models=tmp_path / "models")
    for form in (betas, betas[None], np.tile(betas, (4, 1)), betas[:10], betas.astype(np.float32)):
        write_amass(tmp_path / "amass" / "a_poses.npz", smplh_fields(width=72, betas=form))
        offsets = read_one(tmp_path / "amass", options).skeleton.offsets
        assert np.allclose(offsets[0], model.rest_joints(betas[:10])[0], atol=1e-6)
    write_amass(tmp_path / "amass" / "a_poses.npz", smplh_fields(width=72, betas=None))
    assert np.allclose(read_one(tmp_path / "amass", options).skeleton.offsets[0], model.mean_joints[0], atol=1e-6)


def test_body_poses_alone_take_the_model_s_first_joints(tmp_path: Path) -> None:
    write_body_model(tmp_path / "models" / "SMPLH_FEMALE.npz", LAYOUTS["smplh"], posedirs=np.zeros(1))
    write_amass(tmp_path / "amass" / "a_poses.npz", smplh_fields(width=66))
    motion = read_one(tmp_path / "amass", ReadOptions(body_models=tmp_path / "models"))
    assert motion.skeleton.joint_names == SMPL22.joint_names and motion.skeleton.name == "smplh-female"


def test_what_is_wrong_with_a_model_is_reported(tmp_path: Path) -> None:
    layout = LAYOUTS["smpl"]
    models = tmp_path / "models"
    write_amass(tmp_path / "amass" / "a_poses.npz", smplh_fields(width=72))

    def fault() -> FormatError:
        (item,) = scan([tmp_path / "amass"]).items
        return refusal(read, item, ReadOptions(body_models=models))

    models.mkdir()
    assert fault().reason == "no-body-model" and "smpl/SMPL_FEMALE.npz" in str(fault())
    sparse = np.array({"format": "csc"}, dtype=object)
    for number, (changes, reason) in enumerate(
        [
            ({"J_regressor": sparse}, "object-array"),
            ({"J_regressor": np.zeros((17, 40))}, "bones"),
            ({"shapedirs": np.zeros((3, 3, 10))}, "channel-count"),
        ]
    ):
        models = tmp_path / str(number)
        write_body_model(models / "SMPL_FEMALE.npz", layout, **changes)
        assert fault().reason == reason, changes
