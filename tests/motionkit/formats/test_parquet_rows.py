"""Rows of motions: what the least of them needs, and what is said of those that are none."""

from fractions import Fraction

import numpy as np
import pandas as pd
import pytest

from motionkit.errors import FormatError
from motionkit.formats.items import ReadOptions
from motionkit.formats.registry import read, scan
from motionkit.skeleton import SMPL22

LEAST = {"sequence_id": "a", "joint_positions": np.arange(132, dtype=np.float32), "num_joints": 22, "fps": 59.94}


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


@pytest.mark.parametrize(
    ("change", "reason", "says"),
    [
        ({"num_joints": 23}, "channel-count", "132 numbers, expected frames of 23 × 3"),
        ({"num_joints": 0}, "truncated", "not rows of motions"),
        ({"joint_positions": np.zeros(0, np.float32)}, "channel-count", "0 numbers"),
        ({"joint_positions": np.full(132, np.nan, np.float32)}, "nan", "no number"),
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
    (tmp_path / "other").mkdir()
    pd.DataFrame({"x": [1]}).to_parquet(tmp_path / "other" / "x.parquet")
    assert not scan([tmp_path / "other"]).items
