"""A motion on another skeleton: the same skeleton gives the same motion, limbs point where the source's do."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

import motionkit as mk
from motionkit.core import kinematics
from motionkit.core.skeleton import Skeleton
from motionkit.core.timegrid import TimeGrid
from motionkit.io.retargeting import retarget, stands
from motionkit.io.smpl_body import mean_shape_skeleton

LIMBS = [("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle")]


@pytest.fixture(scope="module")
def motion() -> mk.Motion:
    """Two seconds of arms and legs that turn about themselves too, on SMPL's mean shape."""
    rng, skeleton = np.random.default_rng(2), mean_shape_skeleton()
    angles = np.cumsum(rng.normal(0, 0.02, (60, 22, 3)), axis=0) + rng.normal(0, 0.3, (22, 3))
    rotations = kinematics.rotation_vector_to_quaternion(angles).astype(np.float32)
    root = np.array([0.3, 0.9, -1.0], np.float32) + np.linspace(0, 1, 60, dtype=np.float32)[:, None]
    places = kinematics.forward_kinematics(rotations, root, skeleton)
    return mk.Motion(places, skeleton, TimeGrid(Fraction(30), 60), rotations, root, action="dance")


def directions(motion: mk.Motion) -> np.ndarray:
    """Of both sides' limbs, [T, 8, 3]."""
    index, places = motion.skeleton.index, motion.joint_positions
    bones = np.stack(
        [
            places[:, index(f"{side}_{below}")] - places[:, index(f"{side}_{above}")]
            for side in ("left", "right")
            for above, below in LIMBS
        ],
        axis=1,
    )
    return np.asarray(bones / np.linalg.norm(bones, axis=-1, keepdims=True))


def turned_at_rest(skeleton: Skeleton, joint: str, vector: tuple[float, float, float]) -> Skeleton:
    """The skeleton whose rest pose has a joint and what hangs on it turned: an A-pose, another facing."""
    turn = kinematics.rotation_vector_to_quaternion(np.array(vector))
    below = {skeleton.index(joint)}
    offsets = skeleton.offsets.astype(np.float64)
    for each, parent in enumerate(skeleton.parents):
        if parent in below:
            below.add(each)
            offsets[each] = kinematics.quaternion_rotate(turn, offsets[each])
    return replace(skeleton, offsets=offsets.astype(np.float32))


def test_onto_its_own_skeleton_nothing_changes(motion: mk.Motion) -> None:
    made = retarget(motion, motion.skeleton)
    assert made.local_rotations is not None and motion.local_rotations is not None
    np.testing.assert_allclose(made.joint_positions, motion.joint_positions, atol=2e-5)
    same = np.abs(np.sum(made.local_rotations * motion.local_rotations, axis=-1))
    assert same.min() > 1 - 1e-6
    assert made.action == "dance" and made.timegrid == motion.timegrid
    assert made.provenance.operations[-1] == "onto the skeleton smpl22-mean-shape: legs and path × 1.000"


@pytest.mark.parametrize(
    ("joint", "vector"),
    [
        ("left_shoulder", (0.0, 0.0, -0.8)),
        ("right_shoulder", (0.0, 0.0, 1.4)),
        ("left_hip", (0.0, 0.0, 0.3)),
        ("pelvis", (0.0, 2.5, 0.0)),
        ("pelvis", (0.0, np.pi, 0.0)),
    ],
)
def test_limbs_point_where_the_source_s_do_whatever_the_rest_pose(
    motion: mk.Motion, joint: str, vector: tuple[float, float, float]
) -> None:
    rig = turned_at_rest(motion.skeleton, joint, vector)
    made = retarget(motion, rig)
    assert stands(rig)
    np.testing.assert_allclose(directions(made), directions(motion), atol=2e-5)
    bones = np.linalg.norm(made.joint_positions[:, 1:] - made.joint_positions[:, rig.parents[1:]], axis=-1)
    np.testing.assert_allclose(bones, np.linalg.norm(rig.offsets[1:], axis=-1)[None].repeat(60, 0), atol=2e-5)
    back = retarget(made, motion.skeleton)
    np.testing.assert_allclose(back.joint_positions, motion.joint_positions, atol=1e-4)


def test_a_root_on_the_floor_and_a_tail_come_along(motion: mk.Motion) -> None:
    body = motion.skeleton
    rig = Skeleton(
        "with-reference",
        ("Reference", *body.joint_names, "tail"),
        (-1, *(parent + 1 for parent in body.parents), 1),
        np.concatenate((np.zeros((1, 3)), [[0.0, 0.95, 0.0]], body.offsets[1:], [[0.0, 0.0, -0.4]])).astype(np.float32),
    )
    made = retarget(motion, rig)
    np.testing.assert_allclose(made.joint_positions[:, 1:23], motion.joint_positions, atol=1e-3)
    tail = made.joint_positions[:, 23] - made.joint_positions[:, 1]
    np.testing.assert_allclose(np.linalg.norm(tail, axis=-1), 0.4, atol=1e-5)
