import pickle
from fractions import Fraction

import numpy as np
import pytest

from motionkit.errors import FormatError
from motionkit.motion import Motion
from motionkit.skeleton import KIT21, SMPL22, STANDARD_SKELETONS, Skeleton
from motionkit.timegrid import TimeGrid


def still(num_frames: int = 5, fps: int = 30) -> Motion:
    positions = np.zeros((num_frames, SMPL22.num_joints, 3), np.float32)
    return Motion(joint_positions=positions, skeleton=SMPL22, timegrid=TimeGrid(Fraction(fps), num_frames))


def test_cutting_keeps_the_clock() -> None:
    part = still().frames(2, 4)
    assert part.num_frames == 2
    assert part.timegrid.seconds().tolist() == pytest.approx([2 / 30, 3 / 30])


@pytest.mark.parametrize(("start", "stop"), [(-1, 2), (3, 3), (0, 6)])
def test_cutting_outside_is_refused(start: int, stop: int) -> None:
    with pytest.raises(ValueError, match="do not lie inside"):
        still().frames(start, stop)


def test_shapes_must_agree_with_the_clock_and_the_skeleton() -> None:
    with pytest.raises(ValueError, match="time grid and the skeleton"):
        Motion(np.zeros((4, 22, 3), np.float32), SMPL22, TimeGrid(Fraction(30), 5))
    with pytest.raises(ValueError, match="time grid and the skeleton"):
        Motion(np.zeros((5, 22, 3), np.float32), KIT21, TimeGrid(Fraction(30), 5))


def test_the_operation_log_grows_and_the_original_stays() -> None:
    motion = still()
    assert motion.logged("scaled by 0.01").provenance.operations == ("scaled by 0.01",)
    assert motion.provenance.operations == ()


def test_parents_must_precede_children() -> None:
    with pytest.raises(ValueError, match="precede"):
        Skeleton("bad", ("a", "b", "c"), (-1, 2, 0), np.zeros((3, 3), np.float32))


@pytest.mark.parametrize("skeleton", STANDARD_SKELETONS.values(), ids=lambda skeleton: skeleton.name)
def test_standard_skeletons_are_symmetric(skeleton: Skeleton) -> None:
    for left, right in skeleton.left_right_pairs:
        assert skeleton.offsets[left][0] == pytest.approx(-skeleton.offsets[right][0], abs=0.01)
        assert np.allclose(skeleton.offsets[left][1:], skeleton.offsets[right][1:], atol=0.01)


def test_equal_skeletons_share_a_fingerprint_whatever_their_name() -> None:
    twin = Skeleton("twin", SMPL22.joint_names, SMPL22.parents, SMPL22.offsets, SMPL22.left_right_pairs, SMPL22.feet)
    assert twin == SMPL22
    assert twin.fingerprint != KIT21.fingerprint


def test_format_errors_survive_the_way_between_processes() -> None:
    error = FormatError("expected 66 numbers, found 65", path="a.bvh", reason="channel-count", line=12, frame=3)
    twin = pickle.loads(pickle.dumps(error))  # noqa: S301
    assert str(twin) == str(error) == "a.bvh, line 12, frame 3: expected 66 numbers, found 65"
    assert twin.reason == "channel-count"
