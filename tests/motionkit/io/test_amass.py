from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from motionkit.core.motion import Motion
from motionkit.core.skeletons.mapping import rest_positions
from motionkit.io.registry import ReadOptions
from motionkit.io.scan import read, scan
from motionkit.io.smpl_body import mean_shape_skeleton
from tests.helpers.amass_samples import WIDTHS, smplh_fields, stageii_fields, standing_poses, write_amass
from tests.helpers.refusal import refusal


def read_one(folder: Path, options: ReadOptions | None = None) -> Motion:
    found = scan([folder], options)
    assert not found.problems
    (item,) = found.items
    return read(item, options)


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
    body_only = {key: parts[key] for key in ("root_orient", "pose_body")} | {"trans": fields["trans"]}
    write_amass(tmp_path / "body" / "a.npz", body_only | {"mocap_frame_rate": 60})
    assert np.array_equal(read_one(tmp_path / "body").joint_positions, whole.joint_positions)


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


def test_shapes_beside_the_motions_are_left_out(tmp_path: Path) -> None:
    write_amass(tmp_path / "s1" / "a_poses.npz", smplh_fields())
    write_amass(tmp_path / "s1" / "shape.npz", {"betas": np.zeros(16), "gender": "male"})
    write_amass(tmp_path / "s2" / "b_stageii.npz", stageii_fields())
    write_amass(tmp_path / "s2" / "neutral_stagei.npz", {"betas": np.zeros(16), "gender": "neutral"})
    found = scan([tmp_path])
    assert [item.path.name for item in found.items] == ["a_poses.npz", "b_stageii.npz"] and not found.problems
