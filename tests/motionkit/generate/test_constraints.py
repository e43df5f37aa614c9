"""What motions are held to: as values, as files and words of the command line, and how well a motion meets it."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from motionkit.generate.constraints import Constraint, followed
from motionkit.generate.models import GenerationRequest
from motionkit.generate.request import parse_joint, parse_pose, read_path, read_prompts
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


def test_how_far_a_motion_is_from_its_path() -> None:
    met = followed(WALK, Constraint.path([(0, 0), (4, 0)], [0, 4]))
    assert met.max_metres < 1e-6 and met.mean_degrees is None
    beside = followed(WALK, Constraint.path([(0, 0.3), (4, 0.3)], [0, 4], [0.0, 0.0]))
    assert (beside.mean_metres, beside.max_metres) == pytest.approx((0.3, 0.3), abs=1e-6)
    assert beside.mean_degrees is not None


def test_a_pose_may_stand_anywhere_or_where_it_is() -> None:
    [pose] = walking(np.array([2.0]))
    turned = np.stack((pose[:, 2], pose[:, 1], -pose[:, 0]), axis=-1) + np.array([5.0, 0.0, -3.0])
    assert followed(WALK, Constraint.pose(turned, 3.0)).max_metres < 1e-5
    assert followed(WALK, Constraint.pose(turned, 3.0, placed=True)).mean_metres > 1
    assert followed(WALK, Constraint.pose(pose, 3.0, placed=True)).mean_metres == pytest.approx(1.0, abs=1e-5)
    assert followed(WALK, Constraint.pose(pose, 2.0, placed=True, joints=["head"])).max_metres < 1e-5


def test_what_lies_in_a_stretch_goes_by_its_clock() -> None:
    path = Constraint.path([(0, 0), (8, 0)], [0, 8])
    part = path.between(3.0, 5.0)
    assert part is not None and (part.seconds.min(), part.seconds.max()) == (0.0, 2.0)
    np.testing.assert_allclose(part.positions[:, 0, 0], 3.0 + part.seconds)
    assert path.between(9.0, 12.0) is None
    np.testing.assert_array_equal(path.later(2.0).seconds, path.seconds + 2.0)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Constraint.joint("elbow", (0, 0, 0), 1.0),
        lambda: Constraint.pose(BODY, 1.0, joints=["head", "tail"]),
        lambda: Constraint.path([(0, 0)], [0]),
        lambda: Constraint.path([(0, 0), (1, 1)], [1, 1]),
        lambda: Constraint.joint("head", (0, np.inf, 0), 1.0),
        lambda: Constraint.joint("head", (0, 0, 0), -1.0),
    ],
)
def test_what_is_no_constraint(make) -> None:
    with pytest.raises(mk.UsageError):
        make()


def table(folder: Path, text: str) -> Path:
    path = folder / "points.csv"
    path.write_text(text)
    return path


def test_a_table_says_where_and_when(tmp_path: Path) -> None:
    stated = read_path(table(tmp_path, "seconds,x,z,heading_degrees\n0,0,0,0\n2.5,0,3,90\n"))
    assert stated.seconds is not None and stated.seconds[-1] == 2.5
    path = stated.constraint(2.5)
    assert path.name == "points.csv" and np.degrees(path.heading[-1]) == pytest.approx(90)


def test_points_alone_are_walked_evenly(tmp_path: Path) -> None:
    points = read_path(table(tmp_path, "x,z\n0,0\n0,1\n3,1\n"))
    path = points.constraint(8.0)
    np.testing.assert_allclose(path.positions[np.isclose(path.seconds, 2.0), 0][:, [0, 2]], [[0, 1]], atol=1e-9)
    with pytest.raises(mk.UsageError, match="--seconds"):
        points.constraint(None)


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("a,b\n0,0\n", ", line 1"),
        ("x,z\n0,0\n1,north\n", ", line 3"),
        ("x,z\n0,0,7\n1,1\n", ", line 2"),
        ("seconds,x,z\n0,0,0\n2,1,1\n1,2,2\n", ""),
        ("x,z\n0,0\n0,0\n", ""),
        ('x,z\n"0,0\n', ""),
    ],
)
def test_a_table_that_is_no_path_is_reported(tmp_path: Path, text: str, place: str) -> None:
    with pytest.raises(mk.UsageError, match=rf"points\.csv{place}"):
        read_path(table(tmp_path, text)).constraint(6.0)


def test_a_pose_of_a_capture_at_an_instant(tmp_path: Path) -> None:
    seconds = np.arange(9) / 8
    motion = mk.Motion(walking(seconds), mk.SMPL22, mk.TimeGrid(Fraction(8), 9))
    write_npz(motion, tmp_path / "clip.npz")
    pose = parse_pose(f"2.0={tmp_path / 'clip.npz'}@0.3", placed=True)
    np.testing.assert_allclose(pose.positions, walking(np.array([0.3])), atol=1e-6)
    assert pose.seconds.tolist() == [2.0] and pose.name.startswith(str(tmp_path / "clip.npz"))
    write_npz(motion[0.5:0.55], tmp_path / "pose.npz")
    alone = parse_pose(f"2={tmp_path / 'pose.npz'}")
    assert alone.frame == "body" and alone.positions.shape == (1, 22, 3)
    for instant in ("", "@9"):
        with pytest.raises(mk.UsageError, match=r"clip\.npz"):
            parse_pose(f"2={tmp_path / 'clip.npz'}{instant}")


@pytest.mark.parametrize(
    ("parse", "given"),
    [
        *((parse_pose, given) for given in ("pose.npz", "2=", "nan=pose.npz")),
        *((parse_joint, given) for given in ("hip", "hip@1=0,1", "head@1=a,b,c", "head@2-1=0,1,2")),
    ],
)
def test_words_that_are_no_pose_and_no_joint(parse, given: str) -> None:
    with pytest.raises(mk.UsageError):
        parse(given)


def test_one_text_a_line(tmp_path):
    path = tmp_path / "prompts.txt"
    path.write_text("a person walks, slowly\n\n  a jump \n")
    prompts = read_prompts(path, 4.0)
    assert [prompt.request.text for prompt in prompts] == ["a person walks, slowly", "a jump"]
    assert {prompt.request.duration_seconds for prompt in prompts} == {4.0}
    assert prompts[1].where == f"{path}, line 3: "


def test_a_table_of_texts_and_actions(tmp_path):
    (tmp_path / "p.csv").write_text('﻿text,seconds,action\n"up, then down",2.5,\n,,jump\n', encoding="utf-8")
    found = [prompt.request for prompt in read_prompts(tmp_path / "p.csv")]
    assert found == [GenerationRequest(2.5, text="up, then down"), GenerationRequest(None, action="jump")]


@pytest.mark.parametrize(
    ("name", "text", "place"),
    [
        ("p.xlsx", "a walk", ""),
        ("p.txt", " \n", ""),
        ("p.txt", "a walk\n\xff\xfe\n", ""),
        ("p.csv", "words\na walk\n", ", line 2: .*'words'"),
        ("p.csv", "seconds\n2\n", ", line 2"),
        ("p.csv", "text,seconds\na walk, slowly,2\n", ", line 2"),
        ("p.csv", "text,action\na walk,walk\n", ", line 2"),
        ("p.csv", "text,seconds\na walk,-1\n", ", line 2: seconds"),
        ("p.csv", 'text\n"a walk\n', ""),
    ],
)
def test_faults_are_named_with_their_line(tmp_path, name, text, place):
    (tmp_path / name).write_bytes(text.encode("latin-1"))
    with pytest.raises(mk.UsageError, match=name + place):
        read_prompts(tmp_path / name)
