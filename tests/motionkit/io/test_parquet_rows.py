"""Rows of motions: what the least of them needs, and what is said of those that are none."""

import json
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pandas as pd
import pytest

from motionkit.core.errors import FormatError
from motionkit.core.motion import Caption, Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import map_joints
from motionkit.core.timegrid import TimeGrid
from motionkit.io import parquet
from motionkit.io.reading import read
from motionkit.io.registry import ReadOptions
from motionkit.io.scan import scan

LEAST = {"sequence_id": "a", "joint_positions": np.arange(132, dtype=np.float32), "num_joints": 22, "fps": 59.94}

BONES = {"parents": SMPL22.parents, "offsets": SMPL22.offsets.ravel()}


def save(folder, *rows):
    (folder / "data").mkdir(parents=True)
    pd.DataFrame(rows).to_parquet(folder / "data" / "train.parquet")
    return folder


def read_one(folder, **options):
    (item,) = scan([folder]).items
    return read(item, ReadOptions(**options))


def test_the_least_of_a_row(tmp_path):
    motion = read_one(save(tmp_path / "mine", LEAST))
    assert (motion.fps, motion.skeleton, motion.sequence_id) == (Fraction(60000, 1001), SMPL22, "mine/a")
    assert motion.provenance.source_format == "parquet"
    np.testing.assert_array_equal(motion.joint_positions.ravel(), np.arange(132))


def test_files_without_a_data_folder_and_wide_numbers(tmp_path):
    pd.DataFrame([LEAST | {"joint_positions": np.arange(132.0)}]).to_parquet(tmp_path / "rows.parquet")
    assert read_one(tmp_path).num_frames == 2


def test_options(tmp_path):
    motion = read_one(save(tmp_path / "mine", LEAST), fps=Fraction(30), unit_metres=0.01)
    assert (motion.fps, motion.num_frames) == (Fraction(30), 2)
    np.testing.assert_allclose(motion.joint_positions.ravel(), np.arange(132) / 100, rtol=1e-6)


def test_captions_are_sentences_or_structs(tmp_path):
    sentences = read_one(save(tmp_path / "a", LEAST | {"captions": ["walks", "a man walks"]}))
    assert sentences.captions == (Caption("walks"), Caption("a man walks"))
    timed = read_one(save(tmp_path / "b", LEAST | {"captions": [{"text": "walks", "end_seconds": 0.5, "who": "me"}]}))
    assert timed.captions == (Caption("walks", 0.0, 0.5),)


def test_what_the_source_said_of_its_framerate(tmp_path):
    assert read_one(save(tmp_path / "a", LEAST)).provenance.stated_fps == "fps: 60000/1001"
    assert read_one(save(tmp_path / "b", LEAST | {"stated_fps": ""})).provenance.stated_fps == ""


def test_a_skeleton_comes_back_with_the_users_own_map(tmp_path):
    # The standard layout's rows with every joint called by another name.
    rows = {name: f"My {name}" for name in SMPL22.joint_names}
    layout_map = json.dumps({"name": "mine", "requires": ["My pelvis"], "smpl22": rows}, sort_keys=True)
    skeleton = replace(SMPL22, name="mine", joint_names=tuple(rows.values()), layout_map=layout_map)
    motion = Motion(np.ones((2, 22, 3), np.float32), skeleton, TimeGrid(Fraction(30), 2), sequence_id="a")
    after = read_one(save(tmp_path / "mine", parquet.row_of(motion)))
    assert after.skeleton == skeleton and after.skeleton.layout_map == layout_map
    np.testing.assert_array_equal(map_joints(after, "smpl22"), motion.joint_positions)


def test_a_row_without_an_id_is_reported(tmp_path):
    found = scan([save(tmp_path / "mine", LEAST, LEAST | {"sequence_id": None})])
    assert [str(problem.message) for problem in found.problems] == ["row 1: no sequence_id"]
    assert [item.sequence_id for item in found.items] == ["mine/a"]


@pytest.mark.parametrize(
    ("change", "reason", "says"),
    [
        ({"num_joints": 23}, "channel-count", "132 numbers, expected frames of 23 × 3"),
        ({"num_joints": 0}, "channel-count", "num_joints is 0"),
        ({"num_joints": 11}, "channel-count", "11 joints without joint_names"),
        ({"joint_positions": np.zeros(0, np.float32)}, "channel-count", "0 numbers"),
        ({"joint_positions": np.full(132, np.nan, np.float32)}, "nan", "joint_positions: nan where a number"),
        ({"joint_positions": np.full(132, 1e30, np.float32)}, "range", "joint_positions: 1.0"),
        ({"local_rotations": np.full(176, 3, np.float32)}, "range", "local_rotations: a quaternion's length"),
        ({"joint_names": SMPL22.joint_names, "layout_map": "{"} | BONES, "skeleton-map", "layout map"),
        ({"joint_positions": ["x"] * 132}, "truncated", "not rows of motions"),
        ({"fps": None}, "no-framerate", "--fps"),
        ({"fps": -1.0}, "frame-time", "between 1 and"),
        ({"fps_numerator": 30, "fps_denominator": 0}, "frame-time", "fps"),
        ({"joint_names": ["a"], "parents": [-1], "offsets": [0.0, 0.0, 0.0]}, "truncated", "not rows"),
        ({"local_rotations": np.zeros(7, np.float32)}, "channel-count", "local_rotations"),
    ],
)
def test_what_is_wrong_is_explained(tmp_path, change, reason, says):
    with pytest.raises(FormatError, match=says) as caught:
        read_one(save(tmp_path / "mine", LEAST | change))
    assert caught.value.reason == reason


def test_broken_files_and_other_tables(tmp_path):
    folder = save(tmp_path / "mine", LEAST)
    (folder / "data" / "validation.parquet").write_bytes(b"PAR1 and no more")
    found = scan([folder])
    assert [problem.reason for problem in found.problems] == ["truncated"]
    assert len(found.items) == 1
    whole = (folder / "data" / "train.parquet").read_bytes()
    (folder / "data" / "validation.parquet").write_bytes(whole.replace(b"num_joints", b"num\xffjoints"))
    assert [problem.reason for problem in scan([folder]).problems] == ["truncated"]
    (tmp_path / "other").mkdir()
    pd.DataFrame({"x": [1]}).to_parquet(tmp_path / "other" / "x.parquet")
    assert not scan([tmp_path / "other"]).items
