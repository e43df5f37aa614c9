"""Own skeletons by encoders for 22 joints: nothing changes where nothing is known better, and much where it is."""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import motionkit as mk
from motionkit.core import kinematics
from motionkit.fields.interpolation import INTERPOLATORS, Interpolator
from motionkit.fields.motion_field import Joints, MotionField, Observation, Poses, to_motion
from motionkit.fields.rig import on_bones
from motionkit.fields.transfer import Transferred, canonical_observation
from motionkit.io.smpl_body import mean_shape_skeleton
from tests.helpers.analytic import analytic_motion
from tests.helpers.bones import bone_lengths, mixamo_name
from tests.helpers.completing import complete

CUBIC, SLERP = INTERPOLATORS["rotation-cubic"], INTERPOLATORS["slerp"]
FPS = Fraction(30)


def mixamo() -> mk.Skeleton:
    """A rig with MotionBuilder's names, arms along x, with a finger and a reference joint of its own above the hips."""
    body = mean_shape_skeleton()
    root, finger = [0.0, 0.95, 0.0], [0.09, 0.0, 0.02]
    return mk.Skeleton(
        "rig",
        ("Reference", *map(mixamo_name, body.joint_names), "LeftHandIndex1"),
        (-1, *(parent + 1 for parent in body.parents), 1 + body.index("left_wrist")),
        np.concatenate((np.zeros((1, 3)), [root], body.offsets[1:], [finger])).astype(np.float32),
    )


def swinging(skeleton: mk.Skeleton, seed: int = 0, num_frames: int = 91) -> mk.Motion:
    """Every joint swings smoothly about its own axis; the hips travel inside a reference that stays."""
    rng = np.random.default_rng(seed)
    seconds = np.arange(num_frames) / float(FPS)
    joints = skeleton.num_joints
    axes = rng.normal(size=(joints, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    phases, rates = rng.uniform(0, 6, joints), rng.uniform(0.8, 1.6, joints)
    angles = 0.5 * np.sin(2 * np.pi * rates * seconds[:, None] + phases)
    angles[:, 0] = 0.0
    local = Rotation.from_rotvec((angles[..., None] * axes).reshape(-1, 3)).as_quat(scalar_first=True)
    local = local.reshape(num_frames, joints, 4).astype(np.float32)
    bones = np.repeat(skeleton.offsets[None], num_frames, axis=0).astype(np.float32)
    travels = 1 if skeleton.joint_names[0] == "Reference" else 0
    bones[:, travels, 0] += 0.3 * np.sin(5 * seconds)
    bones[:, travels, 2] += 0.8 * seconds
    positions = kinematics.forward_kinematics(local, bones[:, 0], skeleton, bones)
    return mk.Motion(positions, skeleton, mk.TimeGrid(FPS, num_frames), local, positions[:, 0])


@dataclass(frozen=True)
class Oracle:
    """Knows a motion in the 22-joint layout, and answers with its interpolated frames whatever it is shown."""

    truth: Observation
    name: str = "oracle"

    def encode(
        self, observation: Observation, *, before_seconds: float = 0.0, after_seconds: float = 0.0
    ) -> MotionField:
        assert observation.skeleton.joint_names == mk.SMPL22.joint_names
        return CUBIC.encode(self.truth, before_seconds=before_seconds, after_seconds=after_seconds)


def gaps(num_frames: int) -> np.ndarray:
    observed = np.ones(num_frames, bool)
    observed[10:30] = observed[45:70] = False
    return observed


@pytest.mark.parametrize("interpolator", [CUBIC, SLERP], ids=lambda each: each.name)
@pytest.mark.parametrize("rotations", [True, False])
def test_with_the_interpolator_itself_as_the_model_nothing_changes(interpolator: Interpolator, rotations: bool) -> None:
    motion = swinging(mixamo())
    if not rotations:
        motion = mk.Motion(motion.joint_positions, motion.skeleton, motion.timegrid)
    asked = {"fps": Fraction(75), "observed": gaps(motion.num_frames), "after_seconds": 0.2}
    plain = complete(motion, interpolator, **asked)
    carried = complete(motion, Transferred(interpolator, interpolator), **asked)
    np.testing.assert_allclose(carried.joint_positions, plain.joint_positions, atol=2e-6)
    assert (carried.local_rotations is None) == (not rotations)
    if rotations:
        assert plain.local_rotations is not None and carried.local_rotations is not None
        alike = np.abs(np.sum(plain.local_rotations * carried.local_rotations, axis=-1))
        assert alike.min() > 1 - 1e-6
        np.testing.assert_allclose(carried.root_translation, plain.root_translation, atol=1e-6)


def test_what_is_known_of_the_22_joints_comes_over_to_the_rig() -> None:
    motion = swinging(mixamo())
    truth = canonical_observation(Observation.of(motion))
    observed = gaps(motion.num_frames)
    plain = complete(motion, CUBIC, observed=observed)
    carried = complete(motion, Transferred(Oracle(truth), CUBIC), observed=observed)

    def error(made: mk.Motion) -> float:
        off = np.linalg.norm(made.joint_positions - motion.joint_positions, axis=-1)[~observed]
        return float(off[:, 1:].mean())

    assert error(plain) > 0.05
    assert error(carried) < 0.15 * error(plain)
    # The pelvis, whose path alone is wanted, is where it was.
    hips = motion.skeleton.index("Hips")
    np.testing.assert_allclose(carried.joint_positions[:, hips], motion.joint_positions[:, hips], atol=2e-4)


def test_bones_keep_their_length_and_the_reference_its_place() -> None:
    motion = swinging(mixamo(), seed=2)
    truth = canonical_observation(Observation.of(swinging(mixamo(), seed=5)))  # another motion: a large correction
    made = complete(motion, Transferred(Oracle(truth), SLERP), observed=gaps(motion.num_frames))
    bones = Joints.of(Poses.of(made), made.skeleton).bones
    rigid = np.arange(2, made.skeleton.num_joints)
    np.testing.assert_allclose(
        bones[:, rigid], np.broadcast_to(made.skeleton.offsets[rigid], bones[:, rigid].shape), atol=2e-6
    )
    np.testing.assert_allclose(made.joint_positions[:, 0], motion.joint_positions[:, 0], atol=1e-6)
    assert made.local_rotations is not None and motion.local_rotations is not None
    # A finger has no counterpart: it keeps the rotation in the hand that it was interpolated with.
    finger = motion.skeleton.index("LeftHandIndex1")
    plain = complete(motion, SLERP, observed=gaps(motion.num_frames))
    assert plain.local_rotations is not None
    alike = np.abs(np.sum(plain.local_rotations[:, finger] * made.local_rotations[:, finger], axis=-1))
    assert alike.min() > 1 - 1e-6


@pytest.fixture(scope="module")
def walk() -> mk.Motion:
    performance = analytic_motion("walk", 2.0)
    return to_motion(performance, Fraction(30)).frames(0, 60)


@pytest.mark.parametrize("name", ["linear", "cubic"])
def test_bones_keep_their_length_and_joints_come_where_the_field_has_them(name: str, walk: mk.Motion) -> None:
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
