"""clip-FID of motions in memory: the definition's own number, whatever the motions come as."""

from fractions import Fraction

import pytest

import motionkit as mk
from eval import clip_fid
from eval.clip_fid import features
from eval.clip_fid.clips import ClipError, Protocol
from eval.clip_fid.features import kinematic_source
from eval.clip_fid.score import score_rows
from eval.sets.sets import sample_set
from motionkit.core.errors import MotionkitWarning
from motionkit.fields.motion_field import to_motion
from tests.helpers.analytic import ACTIONS, analytic_motion

# The same definition on fewer clips; the descriptor's fit on all of its 8,192 takes seconds.
FEW = {"clips": 256, "replications": 3}


@pytest.fixture(autouse=True)
def quick_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fit the descriptor on few clips."""
    monkeypatch.setattr(features, "FIT_CLIPS", 512)


@pytest.fixture(scope="module")
def real() -> list[mk.Motion]:
    """Eight analytic motions of three seconds at 60 fps."""
    return [
        to_motion(analytic_motion(action, 3.0, seed), Fraction(60))
        for seed, action in enumerate([*ACTIONS, "walk", "bow"])
    ]


@pytest.fixture(scope="module")
def slowed(real: list[mk.Motion]) -> list[mk.Motion]:
    """The same, brought to 5 fps and back."""
    return [mk.complete(motion.resample(5), fps=60, model="slerp") for motion in real]


def test_it_is_the_number_of_the_definition(real: list[mk.Motion], slowed: list[mk.Motion]) -> None:
    found = clip_fid(real, slowed, **FEW)
    names = [str(number) for number in range(len(real))]
    sets = [sample_set("set", Fraction(60), [m.joint_positions for m in each], names) for each in (real, slowed)]
    protocol = Protocol(num_clips=256, replications=3, detailed_replications=0)
    expected = score_rows(sets[0], {"row": sets[1]}, kinematic_source().fit(sets[0]), protocol)["row"]
    assert found == expected
    assert clip_fid([m.joint_positions for m in real], [m.joint_positions for m in slowed], fps="60", **FEW) == expected
    floor = clip_fid(real, real, **FEW)
    assert floor.value + floor.ci95 < found.value - found.ci95
    assert str(floor) == f"{floor.value:.4g} ± {floor.ci95:.2g}"


def test_another_skeleton_is_brought_to_the_22_joints(real: list[mk.Motion], tmp_path) -> None:
    for number, motion in enumerate(real):
        motion.save(tmp_path / f"{number}.bvh")
    read = list(mk.read_all(tmp_path, unit_metres=0.01))
    assert read[0].skeleton.joint_names != real[0].skeleton.joint_names
    mixed, same = clip_fid(real, read, **FEW), clip_fid(real, real, **FEW)
    assert mixed.value == pytest.approx(same.value, rel=0.05)


def test_one_motion_beside_itself_warns(real: list[mk.Motion], slowed: list[mk.Motion]) -> None:
    with pytest.warns(MotionkitWarning, match="same single motion"):
        assert clip_fid(real[:1], real[:1], **FEW).value == pytest.approx(0.0, abs=1e-9)
    clip_fid(real[:1], slowed[:1], **FEW)  # any warning is an error


def test_framerates_have_to_agree(real: list[mk.Motion]) -> None:
    half = [motion.resample(30) for motion in real]
    with pytest.raises(mk.UsageError, match="these have 30, 60"):
        clip_fid(real, half)
    with pytest.raises(mk.UsageError, match="these have 30, 60"):
        clip_fid(real, real, fps=30)
    with pytest.raises(mk.UsageError, match=r"arrays need fps"):
        clip_fid([m.joint_positions for m in real], [m.joint_positions for m in real])


def test_what_cannot_be_compared_is_reported(real: list[mk.Motion]) -> None:
    with pytest.raises(ClipError, match="generated holds no motion"):
        clip_fid(real, [])
    with pytest.raises(ClipError, match="16 poses"):
        clip_fid(real, [motion.frames(0, 10) for motion in real], **FEW)
