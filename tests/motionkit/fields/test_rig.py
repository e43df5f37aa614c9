"""Fields of positions on bones: lengths are kept, observed frames too, and joints lie where the positions are."""

from fractions import Fraction

import numpy as np
import pytest

from motionkit.core import kinematics
from motionkit.core.motion import Motion
from motionkit.core.skeleton import Skeleton
from motionkit.core.timegrid import TimeGrid
from motionkit.fields.interpolation import INTERPOLATORS
from motionkit.fields.motion_field import Observation, to_motion
from motionkit.fields.rig import on_bones
from tests.helpers.analytic import analytic_motion
from tests.helpers.bones import bone_lengths
from tests.helpers.turning_body import random_motion

ON_POSITIONS = ("linear", "catmull-rom", "cubic")
# A reference on the floor, hips that travel in it, a joint that never turns, then a leg; a tail with two ends.
LEG = Skeleton(
    name="leg",
    joint_names=("reference", "hips", "socket", "knee", "ankle", "tail", "tip"),
    parents=(-1, 0, 1, 2, 3, 1, 5),
    offsets=np.array(
        [[0, 0, 0], [0, 1, 0], [0.1, 0, 0], [0, -0.5, 0], [0, -0.4, 0], [0, 0, -0.2], [0, 0, -0.3]], np.float32
    ),
)


@pytest.fixture(scope="module")
def walk() -> Motion:
    performance = analytic_motion("walk", 2.0)
    return to_motion(performance, Fraction(30)).frames(0, 60)


@pytest.mark.parametrize("name", ON_POSITIONS)
def test_bones_keep_their_length_and_joints_come_where_the_field_has_them(name: str, walk: Motion) -> None:
    observation = Observation.of(walk)
    field = INTERPOLATORS[name].encode(observation, before_seconds=0.1, after_seconds=0.1)
    rigid = on_bones(field, observation)
    assert (rigid.start_seconds, rigid.end_seconds) == (field.start_seconds, field.end_seconds)
    times = np.linspace(field.start_seconds, field.end_seconds, 500)
    wanted, made = field.query(times), rigid.query(times)
    assert made.local_rotations is not None and made.root_translation is not None
    lengths = bone_lengths(walk.joint_positions, walk.skeleton)[0]
    assert np.abs(bone_lengths(wanted.joint_positions, walk.skeleton) - lengths).max() > 1e-3
    np.testing.assert_allclose(
        bone_lengths(made.joint_positions, walk.skeleton), np.tile(lengths, (len(times), 1)), atol=2e-6
    )
    inside = (times >= observation.start_seconds) & (times <= observation.end_seconds)
    distance = np.linalg.norm(made.joint_positions - wanted.joint_positions, axis=-1)[inside]
    assert distance.max() < 8e-3 and distance.mean() < 1e-3
    # The rotations say the same as the positions.
    root = made.root_translation
    reached = kinematics.forward_kinematics(made.local_rotations, root, walk.skeleton)
    np.testing.assert_allclose(reached, made.joint_positions, atol=1e-5)


@pytest.mark.parametrize("name", ON_POSITIONS)
def test_observed_frames_stay_what_they_are(name: str) -> None:
    motion = random_motion(3)
    observation = Observation.of(motion)
    made = on_bones(INTERPOLATORS[name].encode(observation), observation).query(observation.times_seconds)
    np.testing.assert_allclose(made.joint_positions, motion.joint_positions, atol=1e-5)
    assert made.local_rotations is not None and motion.local_rotations is not None
    alike = np.abs(np.sum(made.local_rotations * motion.local_rotations, axis=-1))
    np.testing.assert_allclose(alike, 1.0, atol=1e-4)


def test_what_travels_or_never_turns_is_left_so() -> None:
    frames = 10
    rng = np.random.default_rng(0)
    vectors = np.cumsum(rng.normal(scale=0.05, size=(frames, LEG.num_joints, 3)), axis=0)
    vectors[:, [0, 2]] = 0.0
    rotations = kinematics.rotation_vector_to_quaternion(vectors).astype(np.float32)
    bones = np.tile(LEG.offsets, (frames, 1, 1))
    bones[:, 1] += np.cumsum(rng.normal(scale=0.02, size=(frames, 3)), axis=0)
    root = np.zeros((frames, 3), np.float32)
    positions = kinematics.forward_kinematics(rotations, root, LEG, bones.astype(np.float32))
    motion = Motion(positions, LEG, TimeGrid(Fraction(30), frames), rotations, root)
    observation = Observation.of(motion)
    field = INTERPOLATORS["linear"].encode(observation)
    times = np.linspace(0, field.end_seconds, 100)
    wanted, made = field.query(times), on_bones(field, observation).query(times)
    assert made.local_rotations is not None
    np.testing.assert_array_equal(made.joint_positions[:, 1], wanted.joint_positions[:, 1])
    np.testing.assert_allclose(made.local_rotations[:, [0, 2], 0], 1.0, atol=1e-6)
    np.testing.assert_allclose(bone_lengths(made.joint_positions, LEG)[:, 1:], [[0.1, 0.5, 0.4, 0.2, 0.3]] * 100, 1e-5)
    assert np.linalg.norm(made.joint_positions - wanted.joint_positions, axis=-1).max() < 3e-3
