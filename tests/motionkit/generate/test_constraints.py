"""What motions are held to: as values, as files and words of the command line, and how well a motion meets it."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from motionkit.core.skeleton import SMPL22
from motionkit.generate.constraints import Constraint, followed
from motionkit.generate.request import parse_joint, parse_pose, path_and_seconds, read_path
from motionkit.io.npz import write_npz
from tests.helpers.scripted_model import ScriptedField

BODY = np.random.default_rng(0).normal(size=(22, 3))


def walking(seconds: np.ndarray) -> np.ndarray:
    """A body that goes along X at 1 m/s, its root on the line."""
    there = seconds[:, None, None] * np.array([1.0, 0.0, 0.0])
    return (BODY - BODY[:1] * np.array([1.0, 0.0, 1.0]) + there).astype(np.float32)


WALK = ScriptedField(walking, 4.0)


def test_a_path_goes_through_its_points_and_overshoots_none() -> None:
    path = Constraint.path([(0, 0), (2, 0), (2, 2), (2, 2)], [0, 1, 2, 4])
    assert path.seconds[0] == 0 and path.seconds[-1] == 4 and path.joints == ("pelvis",)
    places = path.positions[:, 0][:, [0, 2]]
    for second, place in ((0, (0, 0)), (1, (2, 0)), (2, (2, 2)), (4, (2, 2))):
        np.testing.assert_allclose(places[np.isclose(path.seconds, second)], [place], atol=1e-12)
    assert places.min() >= -1e-12 and places.max() <= 2 + 1e-12
    assert np.isnan(path.positions[:, 0, 1]).all() and np.isnan(path.heading).all()


def test_a_heading_turns_the_short_way() -> None:
    path = Constraint.path([(0, 0), (0, 1)], [0, 1], np.radians([170, -170]))
    assert np.degrees(path.heading).min() == pytest.approx(170) and np.degrees(path.heading).max() == pytest.approx(190)


def test_how_far_a_motion_is_from_its_path() -> None:
    met = followed(WALK, Constraint.path([(0, 0), (4, 0)], [0, 4]))
    assert met.max_metres < 1e-6 and met.mean_degrees is None
    beside = followed(WALK, Constraint.path([(0, 0.3), (4, 0.3)], [0, 4], [0.0, 0.0]))
    assert (beside.mean_metres, beside.max_metres) == pytest.approx((0.3, 0.3), abs=1e-6)
    assert beside.mean_degrees is not None and beside.plain()["mean_degrees"] == beside.mean_degrees


def test_a_pose_may_stand_anywhere_or_where_it_is() -> None:
    [pose] = walking(np.array([2.0]))
    turned = np.stack((pose[:, 2], pose[:, 1], -pose[:, 0]), axis=-1) + np.array([5.0, 0.0, -3.0])
    assert followed(WALK, Constraint.pose(turned, 3.0)).max_metres < 1e-5
    assert followed(WALK, Constraint.pose(turned, 3.0, placed=True)).mean_metres > 1
    assert followed(WALK, Constraint.pose(pose, 3.0, placed=True)).mean_metres == pytest.approx(1.0, abs=1e-5)
    assert followed(WALK, Constraint.pose(pose, 2.0, placed=True, joints=["head"])).max_metres < 1e-5


def test_a_joint_over_some_time() -> None:
    x, y, z = walking(np.array([1.0]))[0, 3].tolist()
    found = followed(WALK, Constraint.joint(SMPL22.joint_names[3], (x, y, z), 1.0, 2.0))
    assert found.max_metres == pytest.approx(1.0, abs=1e-5) and found.mean_metres == pytest.approx(0.5, abs=1e-5)


def test_what_lies_in_a_stretch_goes_by_its_clock() -> None:
    path = Constraint.path([(0, 0), (8, 0)], [0, 8])
    part = path.between(3.0, 5.0)
    assert part is not None and (part.seconds.min(), part.seconds.max()) == (0.0, 2.0)
    np.testing.assert_allclose(part.positions[:, 0, 0], 3.0 + part.seconds)
    assert path.between(9.0, 12.0) is None
    np.testing.assert_array_equal(path.later(2.0).seconds, path.seconds + 2.0)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Constraint.joint("elbow", (0, 0, 0), 1.0), "no joint is called 'elbow'; there are pelvis"),
        (lambda: Constraint.pose(BODY, 1.0, joints=["head", "tail"]), "no joint is called 'tail'"),
        (lambda: Constraint.path([(0, 0)], [0]), "two points or more"),
        (lambda: Constraint.path([(0, 0), (1, 1)], [1, 1]), "seconds that ascend"),
        (lambda: Constraint.joint("head", (0, np.inf, 0), 1.0), "position is infinite"),
        (lambda: Constraint.joint("head", (0, 0, 0), -1.0), "seconds from 0 on"),
    ],
)
def test_what_is_no_constraint(make, message: str) -> None:
    with pytest.raises(mk.UsageError, match=message):
        make()


def table(folder: Path, text: str) -> Path:
    path = folder / "points.csv"
    path.write_text(text)
    return path


def test_a_table_says_where_and_when(tmp_path: Path) -> None:
    stated, seconds = path_and_seconds(table(tmp_path, "seconds,x,z,heading_degrees\n0,0,0,0\n2.5,0,3,90\n"), None)
    assert stated is not None and seconds == 2.5
    path = stated.constraint(seconds)
    assert path.name == "points.csv" and np.degrees(path.heading[-1]) == pytest.approx(90)
    assert path_and_seconds(tmp_path / "points.csv", 4.0)[1] == 4.0 and path_and_seconds(None, None) == (None, None)


def test_points_alone_are_walked_evenly(tmp_path: Path) -> None:
    points = read_path(table(tmp_path, "x,z\n0,0\n0,1\n3,1\n"))
    path = points.constraint(8.0)
    np.testing.assert_allclose(path.positions[np.isclose(path.seconds, 2.0), 0][:, [0, 2]], [[0, 1]], atol=1e-9)
    with pytest.raises(mk.UsageError, match="--seconds"):
        points.constraint(None)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b\n0,0\n", r"points\.csv, line 1: expected the columns x and z"),
        ("x,z\n0,0\n1,north\n", r"points\.csv, line 3: z is a number, not 'north'"),
        ("x,z\n0,0\n1\n", "line 3: z is a number"),
        ("x,z\n0,0,7\n1,1\n", "line 2: more fields"),
        ("seconds,x,z\n0,0,0\n2,1,1\n1,2,2\n", r"points\.csv: a path has two points or more, at seconds that ascend"),
        ("seconds,x,z\n-1,0,0\n2,1,1\n", r"points\.csv: instants are seconds from 0 on"),
        ("x,z\n0,0\n0,0\n", r"points\.csv: the same point twice"),
        ("seconds,x,z\n0,0,0\n3,0,3\n7.5,0,6\n", r"points\.csv: 7\.5 s lies outside the motion's 0 … 6 s"),
        ('x,z\n"0,0\n', "not a CSV table"),
    ],
)
def test_a_table_that_is_no_path_is_reported(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(mk.UsageError, match=message):
        read_path(table(tmp_path, text)).constraint(6.0)
    with pytest.raises(mk.UsageError, match=r"nowhere\.csv: No such file"):
        read_path(tmp_path / "nowhere.csv")


def test_a_pose_of_a_capture_at_an_instant(tmp_path: Path) -> None:
    seconds = np.arange(9) / 8
    motion = mk.Motion(walking(seconds), SMPL22, mk.TimeGrid(Fraction(8), 9))
    write_npz(motion, tmp_path / "clip.npz")
    pose = parse_pose(f"2.0={tmp_path / 'clip.npz'}@0.3", placed=True)
    np.testing.assert_allclose(pose.positions, walking(np.array([0.3])), atol=1e-6)
    assert pose.seconds.tolist() == [2.0] and pose.name.startswith(str(tmp_path / "clip.npz"))
    write_npz(motion[0.5:0.55], tmp_path / "pose.npz")
    alone = parse_pose(f"2={tmp_path / 'pose.npz'}")
    assert alone.frame == "body" and alone.positions.shape == (1, 22, 3)
    with pytest.raises(mk.UsageError, match=r"clip\.npz holds 9 frames: say which by its second \(--pose 2=.*@0\)"):
        parse_pose(f"2={tmp_path / 'clip.npz'}")
    with pytest.raises(mk.UsageError, match=r"9 s lies outside its 0 … 1 s"):
        parse_pose(f"2={tmp_path / 'clip.npz'}@9")


@pytest.mark.parametrize(
    ("parse", "given", "message"),
    [
        *(
            (parse_pose, given, "--pose takes SECONDS=FILE")
            for given in ("pose.npz", "2=", "=pose.npz", "nan=pose.npz")
        ),
        *((parse_joint, given, "--joint takes NAME@FROM-TO=x,y,z") for given in ("hip", "hip@1=0,1", "@1=0,1,2")),
        (parse_joint, "head@1=a,b,c", "--joint takes NAME@FROM-TO=x,y,z"),
        (parse_joint, "head@2-1=0,1,2", "1 s lies before 2 s"),
    ],
)
def test_words_that_are_no_pose_and_no_joint(parse, given: str, message: str) -> None:
    with pytest.raises(mk.UsageError, match=message):
        parse(given)


def test_a_joint_in_words() -> None:
    joint = parse_joint("left_foot@1.0-1.5=0.2,0.05,-1")
    assert joint.joints == ("left_foot",) and (joint.seconds.min(), joint.seconds.max()) == (1.0, 1.5)
    np.testing.assert_allclose(joint.positions[:, 0], [[0.2, 0.05, -1.0]] * len(joint.seconds))
    assert parse_joint("head@2=0,1.7,0").seconds.tolist() == [2.0]
