"""SMPL's bodies: AMASS's files beside `smplx` and written again, dictionaries, Motion-X's rows, Kimodo's files."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import smplx
import torch
from scipy.spatial.transform import Rotation

import motionkit as mk
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import map_joints, rest_positions
from motionkit.fields.motion_field import to_motion
from motionkit.io.amass import write_amass as write
from motionkit.io.kimodo import SKELETONS, read_kimodo
from motionkit.io.registry import ReadOptions
from motionkit.io.scan import read, scan
from motionkit.io.smpl import read_motion_x, read_smpl
from motionkit.io.smpl_body import LAYOUTS, mean_shape_skeleton
from tests.helpers.amass_samples import (
    WIDTHS,
    read_one,
    smplh_fields,
    stageii_fields,
    standing_poses,
    write_amass,
    write_body_model,
)
from tests.helpers.analytic import analytic_motion
from tests.helpers.bones import check_rotations
from tests.helpers.refusal import refusal
from tests.motionkit.io.test_character import directions


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize(("family", "width"), WIDTHS.items())
def test_every_layout_stands_on_its_feet(tmp_path: Path, family: str, width: int, compressed: bool) -> None:
    fields = stageii_fields() if family == "smplx" else smplh_fields(width=width)
    name = "a_stageii.npz" if family == "smplx" else "a_poses.npz"
    write_amass(tmp_path / "ACCAD" / "s1" / name, fields, compressed=compressed)
    motion = read_one(tmp_path)
    rest = rest_positions(mean_shape_skeleton())
    # SMPL adds the pelvis's rest place in the file's own axes (z up): trans + J0 = (0.498, 1.777, 1.228).
    assert np.allclose(motion.joint_positions, rest - rest[0] + [0.4982, 1.2282, -1.7767], atol=1e-5)
    assert motion.skeleton.name == "smpl22-mean-shape" and motion.num_frames == 4
    assert motion.fps == 120 and motion.provenance.source_format == "amass"
    assert (motion.provenance.subset, motion.provenance.subject) == ("ACCAD", "s1")


def test_positions_are_the_recursive_sum_of_turned_offsets(tmp_path: Path) -> None:
    poses = standing_poses(5) + np.random.default_rng(3).normal(0, 0.4, (5, 156))
    trans = np.random.default_rng(4).normal(0, 1, (5, 3))
    write_amass(tmp_path / "a_poses.npz", smplh_fields(poses=poses, trans=trans))
    motion = read_one(tmp_path)
    skeleton = mean_shape_skeleton()
    upright = Rotation.from_euler("x", -90, degrees=True)
    for frame in range(5):
        place = {0: upright.apply(trans[frame] + skeleton.offsets[0])}
        turn = {0: upright * Rotation.from_rotvec(poses[frame, :3])}
        for joint in range(1, 22):
            parent = skeleton.parents[joint]
            place[joint] = place[parent] + turn[parent].apply(skeleton.offsets[joint])
            turn[joint] = turn[parent] * Rotation.from_rotvec(poses[frame, 3 * joint : 3 * joint + 3])
        assert np.allclose(motion.joint_positions[frame], [place[joint] for joint in range(22)], atol=2e-6)
    assert motion.root_translation is not None
    assert np.allclose(motion.root_translation, motion.joint_positions[:, 0], atol=1e-6)


@pytest.mark.parametrize(
    ("written", "fps"),
    [
        (120.0, Fraction(120)),
        (np.float32(59.94), Fraction(60000, 1001)),
        (120.00004577636719, Fraction(120)),
        (59.9999885, Fraction(60)),
        (np.array([100], np.uint8), Fraction(100)),
        (np.array(30.0, dtype=object), Fraction(30)),
        ("59.94", Fraction(60000, 1001)),
    ],
)
@pytest.mark.parametrize("key", ["mocap_framerate", "mocap_frame_rate"])
def test_framerates_are_snapped_and_kept_as_written(tmp_path: Path, key: str, written: object, fps: Fraction) -> None:
    write_amass(tmp_path / "a_poses.npz", smplh_fields(mocap_framerate=None) | {key: written})
    motion = read_one(tmp_path)
    assert motion.fps == fps
    assert motion.provenance.stated_fps == str(np.array(written).reshape(-1)[0:1].item())
    assert read_one(tmp_path, ReadOptions(fps=Fraction(25))).fps == 25


def test_poses_in_parts_are_those_of_one_array(tmp_path: Path) -> None:
    fields = stageii_fields(poses=np.random.default_rng(0).normal(0, 0.5, (4, 165)))
    poses = fields["poses"]
    assert isinstance(poses, np.ndarray)
    write_amass(tmp_path / "whole" / "a_stageii.npz", fields)
    slices = {"root_orient": (0, 3), "pose_body": (3, 66), "pose_jaw": (66, 69), "pose_eye": (69, 75)}
    parts = {key: poses[:, start:stop] for key, (start, stop) in slices.items()}
    parts["pose_hand"] = poses[:, 75:]
    del fields["poses"]
    write_amass(tmp_path / "parts" / "a_stageii.npz", fields | parts)
    whole, again = (read_one(tmp_path / name) for name in ("whole", "parts"))
    assert np.array_equal(whole.joint_positions, again.joint_positions)


NAN, FAR = standing_poses(), np.zeros((4, 3))
NAN[2, 30], FAR[3, 1] = np.nan, 1e12


@pytest.mark.parametrize(
    ("changes", "reason", "frame"),
    [
        ({"poses": None}, "missing-key", None),
        ({"poses": np.zeros((4, 100))}, "channel-count", None),
        ({"poses": np.zeros((4, 165)), "surface_model_type": "smplh"}, "channel-count", None),
        ({"poses": np.full((4, 156), 90.0)}, "radians", 0),
        ({"trans": np.zeros((3, 3))}, "channel-count", None),
        ({"trans": FAR}, "range", 3),
        ({"poses": NAN}, "nan", 2),
        ({"poses": standing_poses().astype(object)}, "object-array", None),
        ({"mocap_framerate": None}, "no-framerate", None),
        ({"mocap_framerate": np.array([120.0, 60.0])}, "channel-count", None),
        ({"mocap_framerate": np.array(120j)}, "not-a-number", None),
        ({"mocap_framerate": np.array({"fps": 120}, dtype=object)}, "framerate", None),
    ],
)
def test_what_is_wrong_is_reported(tmp_path: Path, changes: dict[str, object], reason: str, frame: int | None) -> None:
    write_amass(tmp_path / "a_poses.npz", smplh_fields(**changes))
    error = refusal(read_one, tmp_path)
    assert (error.reason, error.frame) == (reason, frame)
    assert next(iter(changes)) in str(error) or reason == "no-framerate"


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


def test_what_is_wrong_with_a_model_is_reported(tmp_path: Path) -> None:
    layout = LAYOUTS["smpl"]
    models = tmp_path / "models"
    write_amass(tmp_path / "amass" / "a_poses.npz", smplh_fields(width=72))

    def fault() -> mk.FormatError:
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


def test_smpl_s_own_rotations_come_back_as_they_were(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    poses, trans = standing_poses(5, 165) + rng.normal(0, 0.4, (5, 165)), rng.normal(0, 1, (5, 3))
    fields = stageii_fields(5, poses=poses, trans=trans, mocap_frame_rate=np.array(59.94))
    write_amass(tmp_path / "in" / "a_stageii.npz", fields)
    write_body_model(tmp_path / "models" / "SMPLX_NEUTRAL.npz", LAYOUTS["smplx"], **standing_body(mean_rest()))
    motion = read_one(tmp_path / "in", ReadOptions(body_models=tmp_path / "models"))
    (tmp_path / "out").mkdir()
    write(motion, tmp_path / "out" / "a.npz")
    with np.load(tmp_path / "out" / "a.npz", allow_pickle=False) as made:
        np.testing.assert_allclose(made["poses"], poses, atol=1e-5)
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
def test_what_is_wrong_with_a_dictionary_is_reported(tmp_path, poses, changes, reason):
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
    arrays = {"posed_joints": positions, "global_rot_mats": rotations, "foot_contacts": np.zeros((FRAMES, 4)), **more}
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})
    return positions.astype(np.float32)


@pytest.mark.parametrize("num_joints", [22, 30, 77])
def test_positions_and_rotations(tmp_path, num_joints):
    positions = written(tmp_path / "a.npz", num_joints)
    motion = read_kimodo(tmp_path / "a.npz")
    assert motion.fps == 30
    np.testing.assert_array_equal(motion.joint_positions, positions)
    check_rotations(motion, 2e-6)


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
