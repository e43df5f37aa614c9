from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch

from motionkit.core.motion import Caption, Motion
from motionkit.core.skeleton import KIT21, SMPL22, Skeleton
from motionkit.core.timegrid import TimeGrid
from motionkit.io.npz import read_npz


def still(num_frames: int = 5, fps: int = 30) -> Motion:
    positions = np.zeros((num_frames, SMPL22.num_joints, 3), np.float32)
    return Motion(joint_positions=positions, skeleton=SMPL22, timegrid=TimeGrid(Fraction(fps), num_frames))


def test_cutting_keeps_the_clock() -> None:
    cut = still().frames(2, 4)
    assert cut.num_frames == 2
    assert cut.timegrid.seconds().tolist() == pytest.approx([2 / 30, 3 / 30])
    for start, stop in ((-1, 2), (3, 3), (0, 6)):
        with pytest.raises(ValueError, match=f"{start}"):
            still().frames(start, stop)


def test_shapes_must_agree_with_the_clock_and_the_skeleton() -> None:
    for shape, skeleton in (((4, 22, 3), SMPL22), ((5, 22, 3), KIT21)):
        with pytest.raises(ValueError, match="22"):
            Motion(np.zeros(shape, np.float32), skeleton, TimeGrid(Fraction(30), 5))


def test_equal_skeletons_share_a_fingerprint_whatever_their_name() -> None:
    twin = Skeleton("twin", SMPL22.joint_names, SMPL22.parents, SMPL22.offsets, SMPL22.left_right_pairs, SMPL22.feet)
    assert twin == SMPL22
    assert twin.fingerprint != KIT21.fingerprint


def captioned() -> Motion:
    """Two seconds at 60 fps whose clock begins at 1 s."""
    captions = (
        Caption("all"),
        Caption("first", 1.0, 1.5),
        Caption("middle", 1.25, 2.25, tokens="middle/NOUN"),
        Caption("last", 2.5, 3.0),
        Caption("from the middle on", 2.0),
    )
    positions = np.random.default_rng(0).normal(size=(120, 22, 3)).astype(np.float32)
    return Motion(positions, SMPL22, TimeGrid(Fraction(60), 120, 1.0), captions=captions, sequence_id="take")


def test_seconds_are_those_of_the_clock_and_half_open() -> None:
    motion = captioned()
    part = motion[1.5:2.0]
    assert part.timegrid == TimeGrid(Fraction(60), 30, 1.5)
    np.testing.assert_array_equal(part.joint_positions, motion.joint_positions[30:60])
    assert part[1.75:2.0].timegrid.start_seconds == 1.75
    assert motion[:].num_frames == 120 and motion[2:].num_frames == 60 and motion[:2].num_frames == 60
    # A frame just before the start is not taken, and one at the stop is not either.
    assert motion[1.51:1.99].num_frames == 29
    assert motion[Fraction(4, 3) : 1 + 2 / 3].num_frames == 20
    assert part.sequence_id == "take"


def test_captions_are_cut_with_the_frames() -> None:
    told = [(each.text, each.start_seconds, each.end_seconds) for each in captioned()[1.5:2.5].captions]
    assert told == [("all", 0.0, None), ("middle", 1.5, 2.25), ("from the middle on", 2.0, None)]
    told = [(each.text, each.start_seconds, each.end_seconds) for each in captioned()[1.0:2.0].captions]
    assert told == [("all", 0.0, None), ("first", 1.0, 1.5), ("middle", 1.25, None)]
    assert captioned()[1.5:2.0].captions[1].tokens == "middle/NOUN"


@pytest.mark.parametrize(
    "seconds", [slice(3.0, None), slice(2.0, 1.5), slice(1.501, 1.502), slice(-0.5, None), slice(np.nan, None)]
)
def test_seconds_without_a_frame_are_refused(seconds: slice) -> None:
    with pytest.raises(ValueError):
        captioned()[seconds]


@pytest.mark.parametrize("key", [3, slice(0, 2, 1)])
def test_anything_but_seconds_is_refused(key: object) -> None:
    with pytest.raises(TypeError):
        captioned()[key]  # type: ignore[index]


def test_bare_joints_become_a_motion() -> None:
    motion = Motion.from_joints(np.ones((7, 22, 3)), 59.94)
    assert motion.skeleton is SMPL22 and motion.fps == Fraction(60000, 1001)
    assert motion.joint_positions.dtype == np.float32
    assert Motion.from_joints(np.ones((7, 21, 3), np.float32), "25/2").skeleton is KIT21
    in_centimetres = Motion.from_joints(standing() / 0.01, 30, unit_metres=0.01)
    np.testing.assert_allclose(in_centimetres.joint_positions, standing(), atol=1e-6)
    assert Motion.from_joints(np.ones((7, 22, 3)), 20, SMPL22.scaled(2.0)).skeleton == SMPL22.scaled(2.0)
    with pytest.raises(ValueError, match="24"):
        Motion.from_joints(np.ones((7, 24, 3)), 20)
    with pytest.raises(ValueError, match="fast"):
        Motion.from_joints(np.ones((7, 22, 3)), "fast")


def standing() -> np.ndarray:
    pose = np.zeros((22, 3))
    pose[:, 1] = np.linspace(0, 1.7, 22)
    return np.tile(pose, (7, 1, 1))


def with_nan() -> np.ndarray:
    joints = standing()
    joints[3, 5, 1] = np.nan
    return joints


@pytest.mark.parametrize(
    ("joints", "error", "says"),
    [
        (standing().tolist(), TypeError, "list"),
        (torch.tensor(standing()), TypeError, "torch.Tensor"),
        (standing().astype(object), TypeError, "object"),
        (standing()[0], ValueError, r"\(22, 3\)"),
        (standing()[:0], ValueError, r"\(0, 22, 3\)"),
        (with_nan(), ValueError, "frame 3, joint 5"),
        (standing() * 1000, ValueError, "unit_metres=0.001"),
        (standing() / 0.0254, ValueError, "inches"),
    ],
)
def test_joints_that_are_no_motion_in_metres_are_refused_in_one_line(unchecked_annotations, joints, error, says):
    with pytest.raises(error, match=says) as caught:
        Motion.from_joints(joints, 30)
    assert "\n" not in str(caught.value)


def test_methods_reach_what_lies_above(tmp_path: Path) -> None:
    motion = captioned().frames(0, 20)
    assert motion.resample("120").fps == 120 and motion.resample(23.976).fps == Fraction(24000, 1001)
    motion.save(str(tmp_path / "take.npz"))
    np.testing.assert_array_equal(read_npz(tmp_path / "take.npz").joint_positions, motion.joint_positions)
    assert motion._repr_html_().startswith("<iframe")
