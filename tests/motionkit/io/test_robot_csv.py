"""A robots' table of bodies whose path and turning are known: z up, x ahead, per second."""

from fractions import Fraction

import numpy as np
import pytest

from motionkit.core import kinematics
from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.io.robot_csv import write_robot_csv
from motionkit.io.smpl_body import mean_shape_skeleton

FRAMES, FPS = 61, Fraction(30000, 1001)


def table(motion, folder):
    path = folder / "walk.csv"
    write_robot_csv(motion, path)
    return np.genfromtxt(path, delimiter=",", names=True)


def columns(table, joint, names):
    return np.stack([table[f"{joint}_{name}"] for name in names.split()], axis=-1)


def t_pose(ahead_per_second=0.0, left_turn_per_second=0.0):
    """SMPL's T-pose that faces z, going that way while it turns on the spot."""
    grid, skeleton = TimeGrid(FPS, FRAMES), mean_shape_skeleton()
    turns = np.zeros((FRAMES, 22, 4), np.float32)
    turns[..., 0] = 1.0
    half = grid.seconds() * left_turn_per_second / 2
    turns[:, 0, 0], turns[:, 0, 2] = np.cos(half), np.sin(half)
    path = np.zeros((FRAMES, 3), np.float32)
    path[:, 1], path[:, 2] = 1.0, grid.seconds() * ahead_per_second
    return Motion(kinematics.forward_kinematics(turns, path, skeleton), skeleton, grid, turns, path)


@pytest.mark.parametrize("with_rotations", [True, False])
def test_places_turns_and_velocities_are_those_of_the_body(tmp_path, with_rotations):
    motion = t_pose(ahead_per_second=1.5, left_turn_per_second=0.5)
    if not with_rotations:
        motion = Motion(motion.joint_positions, SMPL22, motion.timegrid)
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
