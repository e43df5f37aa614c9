"""What is drawn of a skeleton: bones, sides, ends, and where the body faces."""

from fractions import Fraction

import numpy as np
import pytest

from motionkit.core.kinematics import quaternion_rotate
from motionkit.core.skeleton import KIT21, SMPL22, Skeleton
from motionkit.core.skeletons.mapping import rest_positions
from motionkit.fields.motion_field import to_motion
from motionkit.viz.player import drawing_of
from tests.helpers.analytic import analytic_motion


def test_bones_sides_and_ends_of_the_22_joints() -> None:
    drawing = drawing_of(SMPL22, rest_positions(SMPL22)[None])
    assert drawing.bones == SMPL22.parents
    assert [SMPL22.joint_names[joint] for joint in drawing.ends] == [
        *("left_foot", "right_foot", "left_wrist", "right_wrist"),
    ]
    sides = {"left": -1, "right": 1}
    assert drawing.sides == tuple(sides.get(name.split("_")[0], 0) for name in SMPL22.joint_names)
    assert SMPL22.joint_names[drawing.head] == "head"


@pytest.mark.parametrize("turned", [-2.5, -0.4, 0.0, 1.2, 3.0])
@pytest.mark.parametrize("skeleton", [SMPL22, KIT21])
def test_the_front_is_where_the_body_was_turned_to(skeleton: Skeleton, turned: float) -> None:
    turn = np.array([np.cos(turned / 2), 0, np.sin(turned / 2), 0], np.float32)
    positions = rest_positions(skeleton)
    drawing = drawing_of(skeleton, quaternion_rotate(np.broadcast_to(turn, (len(positions), 4)), positions)[None])
    # KIT's hips are at the other side of X: its bodies face Z- at rest.
    faces = turned if skeleton is SMPL22 else turned + np.pi
    np.testing.assert_allclose(np.exp(1j * drawing.yaw), np.exp(1j * faces), atol=1e-2)


def test_a_joint_that_travels_hangs_on_no_bone() -> None:
    motion = to_motion(analytic_motion("walk", 2.0), Fraction(30))
    still = Skeleton(
        "on-the-floor",
        ("reference", *motion.skeleton.joint_names),
        (-1, *(parent + 1 for parent in motion.skeleton.parents)),
        np.concatenate([np.zeros((1, 3), np.float32), motion.skeleton.offsets]),
    )
    positions = np.concatenate([np.zeros((motion.num_frames, 1, 3), np.float32), motion.joint_positions], axis=1)
    bones = drawing_of(still, positions).bones
    assert bones[:2] == (-1, -1) and bones[2:] == still.parents[2:]


def test_what_no_table_knows_is_drawn_all_the_same() -> None:
    names = ("body", "leg", "paw", "tail")
    dog = Skeleton("dog", names, (-1, 0, 1, 0), np.eye(4, 3, dtype=np.float32))
    drawing = drawing_of(dog, rest_positions(dog)[None])
    assert drawing.ends == (2, 3) and drawing.head == -1 and drawing.yaw == 0 and drawing.sides == (0, 0, 0, 0)


def test_markers_are_points() -> None:
    markers = Skeleton("markers", ("LFHD", "RFHD", "C7"), (-1, 0, 0), np.zeros((3, 3), np.float32))
    drawing = drawing_of(markers, np.ones((2, 3, 3), np.float32))
    assert drawing.bones == (-1, -1, -1) and drawing.ends == ()
