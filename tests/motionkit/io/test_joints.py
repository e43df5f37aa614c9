"""Joint positions as CSV and as arrays: round trips, framerates, what is refused; and a robot's table."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import motionkit as mk
from motionkit.core import kinematics
from motionkit.io.joints_csv import read_joints_csv, write_joints_csv
from motionkit.io.joints_npy import read_humanact12, read_joints_npy, write_joints_npy
from motionkit.io.registry import ReadOptions
from motionkit.io.robot_csv import write_robot_csv
from motionkit.io.scan import read, scan
from motionkit.io.smpl_body import mean_shape_skeleton
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


@pytest.mark.parametrize("layout", [mk.SMPL22, mk.KIT21])
def test_joints_of_a_layout_in_any_order_are_that_layout(tmp_path, layout):
    positions = np.random.default_rng(0).normal(size=(3, layout.num_joints, 3)).astype(np.float32)
    write_joints_csv(mk.Motion(positions, layout, mk.TimeGrid(Fraction(30), 3, 2.5)), tmp_path / "a.csv")
    table = pd.read_csv(tmp_path / "a.csv")
    table[sorted(table.columns)].to_csv(tmp_path / "b.csv", index=False)
    motion = read_joints_csv(tmp_path / "b.csv")
    assert motion.skeleton is layout
    assert motion.timegrid == mk.TimeGrid(Fraction(30), 3, 2.5)
    np.testing.assert_array_equal(motion.joint_positions, positions)


def test_options_of_a_table(tmp_path):
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
def test_bad_tables_are_refused(tmp_path, text, reason):
    assert refusal(read_joints_csv, save(tmp_path / "bad.csv", text)).reason == reason


def standing(num_frames: int = 5, num_joints: int = 22) -> np.ndarray:
    rotations = np.zeros((num_frames, 22, 4), np.float32)
    rotations[..., 0] = 1.0
    root = np.tile(np.array([0, 0.93, 0], np.float32), (num_frames, 1))
    positions = kinematics.forward_kinematics(rotations, root, mk.SMPL22)
    return np.concatenate((positions, positions[:, : num_joints - 22]), axis=1)


def test_round_trip_with_its_framerate(tmp_path: Path) -> None:
    motion = mk.Motion(standing(), mk.SMPL22, mk.TimeGrid(Fraction(30000, 1001), 5))
    write_joints_npy(motion, tmp_path / "a.npy")
    (item,) = scan([tmp_path]).items
    again = read(item)
    assert again.fps == Fraction(30000, 1001) and again.provenance.stated_fps == "30000/1001"
    assert np.array_equal(again.joint_positions, motion.joint_positions)
    with pytest.raises(ValueError, match=r"motions\.json"):
        write_joints_npy(mk.Motion(standing(), mk.SMPL22, mk.TimeGrid(Fraction(60), 5)), tmp_path / "b.npy")


def test_without_a_framerate_it_says_how_to_give_one(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", standing())
    assert refusal(read_joints_npy, tmp_path / "a.npy").reason == "no-framerate"
    assert read_joints_npy(tmp_path / "a.npy", ReadOptions(fps=Fraction(24))).fps == 24


@pytest.mark.parametrize("turn", ["z up", "y down"])
def test_bodies_are_turned_upright_and_left_stays_left(tmp_path: Path, turn: str) -> None:
    body = standing()
    x, y, z = np.moveaxis(body, -1, 0)
    np.save(tmp_path / "a.npy", np.stack((x, -z, y) if turn == "z up" else (x, -y, -z), axis=-1))
    motion = read_joints_npy(tmp_path / "a.npy", ReadOptions(fps=Fraction(24)))
    assert np.allclose(motion.joint_positions, body, atol=1e-6)


def test_humanact12_clips_are_known_by_name_and_shape(tmp_path: Path) -> None:
    np.save(tmp_path / "P03G01R02F0069T0143A0402.npy", standing(num_joints=24))
    (item,) = scan([tmp_path]).items
    motion = read(item)
    assert (item.format, motion.fps, motion.action, motion.provenance.subject) == ("humanact12", 20, "jump", "03")
    assert motion.joint_positions.shape == (5, 22, 3)
    at_15 = read_humanact12(item.path, ReadOptions(fps=Fraction(15)))
    assert at_15.fps == 15 and at_15.provenance.stated_fps == "20"


@pytest.mark.parametrize("shape", [(4, 20, 3), (4, 22, 2), (0, 22, 3)])
def test_other_shapes_are_refused(tmp_path: Path, shape: tuple[int, ...]) -> None:
    np.save(tmp_path / "a.npy", np.zeros(shape, np.float32))
    refusal(read_joints_npy, tmp_path / "a.npy", ReadOptions(fps=Fraction(24)))


@pytest.mark.parametrize("manifest", ["[]", "{", '{"fps": 0}', '{"layout": "dog"}', '{"fps": null, "unit_metres": -1}'])
def test_a_bad_manifest_is_refused(tmp_path: Path, manifest: str) -> None:
    np.save(tmp_path / "a.npy", standing())
    (tmp_path / "motions.json").write_text(manifest)
    assert refusal(read_joints_npy, tmp_path / "a.npy", ReadOptions(fps=Fraction(24))).reason == "manifest"


FRAMES, FPS = 61, Fraction(30000, 1001)


def table(motion, folder):
    path = folder / "walk.csv"
    write_robot_csv(motion, path)
    return np.genfromtxt(path, delimiter=",", names=True)


def columns(table, joint, names):
    return np.stack([table[f"{joint}_{name}"] for name in names.split()], axis=-1)


def t_pose(ahead_per_second=0.0, left_turn_per_second=0.0):
    """SMPL's T-pose that faces z, going that way while it turns on the spot."""
    grid, skeleton = mk.TimeGrid(FPS, FRAMES), mean_shape_skeleton()
    turns = np.zeros((FRAMES, 22, 4), np.float32)
    turns[..., 0] = 1.0
    half = grid.seconds() * left_turn_per_second / 2
    turns[:, 0, 0], turns[:, 0, 2] = np.cos(half), np.sin(half)
    path = np.zeros((FRAMES, 3), np.float32)
    path[:, 1], path[:, 2] = 1.0, grid.seconds() * ahead_per_second
    return mk.Motion(kinematics.forward_kinematics(turns, path, skeleton), skeleton, grid, turns, path)


@pytest.mark.parametrize("with_rotations", [True, False])
def test_places_turns_and_velocities_are_those_of_the_body(tmp_path, with_rotations):
    motion = t_pose(ahead_per_second=1.5, left_turn_per_second=0.5)
    if not with_rotations:
        motion = mk.Motion(motion.joint_positions, mk.SMPL22, motion.timegrid)
    found = table(motion, tmp_path)
    assert found.dtype.names[:7] == tuple(f"root_{name}" for name in ("x", "y", "z", "qx", "qy", "qz", "qw"))
    seconds = np.arange(FRAMES) / float(FPS)
    assert found["time_seconds"] == pytest.approx(seconds)
    assert columns(found, "root", "x y z") == pytest.approx(np.stack([1.5 * seconds, 0 * seconds, 1 + 0 * seconds], 1))
    half = 0.25 * seconds
    turned = np.stack([0 * half, 0 * half, np.sin(half), np.cos(half)], axis=1)
    for joint in ("root", "left_knee", "head") if with_rotations else ("root",):
        assert columns(found, joint, "qx qy qz qw") == pytest.approx(turned, abs=1e-4)
    assert columns(found, "root", "vx vy vz") == pytest.approx(np.tile([1.5, 0, 0], (FRAMES, 1)), abs=1e-4)
    assert columns(found, "root", "wx wy wz") == pytest.approx(np.tile([0, 0, 0.5], (FRAMES, 1)), abs=1e-3)
    # An arm to the left that turns left goes backwards, ω × r.
    reach = found["left_wrist_y"][0]
    assert reach > 0.6
    assert found["left_wrist_vx"][0] == pytest.approx(1.5 - 0.5 * reach, abs=0.02)


def test_feet_that_stand_are_in_contact_and_feet_that_fly_are_not(tmp_path):
    standing, sliding = table(t_pose(), tmp_path), table(t_pose(ahead_per_second=4.0), tmp_path)
    for foot in ("left_foot_contact", "right_foot_contact"):
        assert (standing[foot] == 1).all()
        assert (sliding[foot] == 0).all()
