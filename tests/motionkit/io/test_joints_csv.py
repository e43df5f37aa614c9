"""Joint positions as CSV: what is read, what is refused and how it is said."""

from fractions import Fraction

import numpy as np
import pandas as pd
import pytest

from motionkit.core.motion import Motion
from motionkit.core.skeleton import KIT21, SMPL22, Skeleton
from motionkit.core.timegrid import TimeGrid
from motionkit.io.joints_csv import read_joints_csv, write_joints_csv
from motionkit.io.registry import ReadOptions
from tests.helpers.refusal import refusal

HEAD = "time_seconds,Hips_x,Hips_y,Hips_z,Head_x,Head_y,Head_z\n"
ROWS = "".join(f"{frame / 60},{frame},0.9,0,{frame},1.6,0.25\n" for frame in range(4))


def save(path, text):
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def test_a_small_table(tmp_path):
    motion = read_joints_csv(save(tmp_path / "take.csv", "\ufeff" + (HEAD + ROWS).replace("\n", "\r\n")))
    assert (motion.fps, motion.provenance.stated_fps) == (Fraction(60), "time_seconds: 60")
    assert motion.skeleton.joint_names == ("Hips", "Head")
    assert motion.skeleton.parents == (-1, 0)
    np.testing.assert_allclose(motion.skeleton.offsets[1], [0, 0.7, 0.25], atol=1e-6)
    np.testing.assert_array_equal(motion.joint_positions[:, 0, 0], np.arange(4))


@pytest.mark.parametrize("layout", [SMPL22, KIT21])
def test_joints_of_a_layout_in_any_order_are_that_layout(tmp_path, layout):
    positions = np.random.default_rng(0).normal(size=(3, layout.num_joints, 3)).astype(np.float32)
    write_joints_csv(Motion(positions, layout, TimeGrid(Fraction(30), 3, 2.5)), tmp_path / "a.csv")
    table = pd.read_csv(tmp_path / "a.csv")
    table[sorted(table.columns)].to_csv(tmp_path / "b.csv", index=False)
    motion = read_joints_csv(tmp_path / "b.csv")
    assert motion.skeleton is layout
    assert motion.timegrid == TimeGrid(Fraction(30), 3, 2.5)
    np.testing.assert_array_equal(motion.joint_positions, positions)


def test_names_with_commas_and_digits_of_any_framerate_survive(tmp_path):
    skeleton = Skeleton("odd", ('a, "b"', "c_x"), (-1, 0), np.zeros((2, 3), np.float32))
    positions = np.random.default_rng(0).normal(size=(50, 2, 3)).astype(np.float32)
    write_joints_csv(Motion(positions, skeleton, TimeGrid(Fraction(24000, 1001), 50)), tmp_path / "a.csv")
    motion = read_joints_csv(tmp_path / "a.csv")
    assert (motion.fps, motion.skeleton.joint_names) == (Fraction(24000, 1001), skeleton.joint_names)
    np.testing.assert_array_equal(motion.joint_positions, positions)


def test_options(tmp_path):
    counted = save(tmp_path / "counted.csv", "frame,a_x,a_y,a_z\n7,100,0,0\n8,200,0,0\n")
    assert refusal(read_joints_csv, counted).reason == "no-framerate"
    motion = read_joints_csv(counted, ReadOptions(fps=Fraction(25), unit_metres=0.01))
    assert motion.fps == 25
    np.testing.assert_allclose(motion.joint_positions[:, 0, 0], [1, 2])
    corrected = read_joints_csv(save(tmp_path / "take.csv", HEAD + ROWS), ReadOptions(fps=Fraction(30)))
    assert (corrected.fps, corrected.provenance.stated_fps) == (Fraction(30), "time_seconds: 60")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("time_seconds;a_x;a_y;a_z\n0;1,5;2;3\n", "not-a-number"),
        ("time_seconds,a_x,a_y,a_z\n0,1,5,2,3\n", "channel-count"),
        ("time_seconds,a_x,a_y,a_z\n0,nan,2,3\n", "nan"),
        ("time_seconds,a_x,a_y,a_z\n0,1e30,2,3\n", "range"),
        ("time_seconds,a_x,a_y\n0,1,2\n", "channel-count"),
        ("time_seconds,a_x,a_y,a_z,a_x\n0,1,2,3,4\n", "channel-count"),
        ("time_seconds,a_x,a_y,a_z\n", "no-frames"),
        ("time_seconds,a_x,a_y,a_z\n0,1,2,3\n", "no-framerate"),
        ("time_seconds,a_x,a_y,a_z\n0,1,2,3\n0.1,1,2,3\n0.2,1,2,3\n0.6,1,2,3\n", "frame-time"),
        ("time_seconds,a_x,a_y,a_z\n0,1,2,3\n0,1,2,3\n", "frame-time"),
        ("frame,a_x,a_y,a_z\n0,1,2,3\n2,1,2,3\n", "frame-number"),
        (b"time_seconds,\xe4_x,\xe4_y,\xe4_z\n0,1,2,3\n", "encoding"),
    ],
)
def test_what_is_wrong_is_explained(tmp_path, text, reason):
    assert refusal(read_joints_csv, save(tmp_path / "bad.csv", text)).reason == reason
