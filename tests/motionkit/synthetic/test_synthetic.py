from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from motionkit.core.errors import UsageError
from motionkit.core.kinematics import forward_kinematics
from motionkit.core.skeleton import SMPL22
from motionkit.fields.motion_field import to_motion
from motionkit.synthetic import ACTIONS, SyntheticMotion, draw_body, make_body, perform
from motionkit.synthetic.curves import band_noise, glide, smoothstep
from motionkit.synthetic.script import Layer

FEET = (7, 10, 8, 11)


def performance(action: str, seed: int = 0, seconds: float = 5.0) -> SyntheticMotion:
    rng = np.random.default_rng([seed, 11])
    return perform(rng, draw_body(rng, "somebody"), [action], seconds)


def turning_about(axis_from: int, joint: int, axis_to: int, positions: np.ndarray) -> np.ndarray:
    before, after = positions[:, joint] - positions[:, axis_from], positions[:, axis_to] - positions[:, joint]
    return np.cross(before, after)


@pytest.mark.parametrize("action", ACTIONS)
def test_every_action_is_humanly_plausible(action: str) -> None:
    field = performance(action)
    motion = to_motion(field, Fraction(120))
    positions = motion.joint_positions.astype(np.float64)
    speed = np.linalg.norm(np.diff(positions, axis=0), axis=-1) * 120
    assert speed.max() < 10.0
    assert positions[:, :, 1].min() > 0.0
    assert positions[:, 15, 1].max() < field.body.height + 0.6
    left = positions[:, 1] - positions[:, 2]
    for hip, knee, ankle in ((1, 4, 7), (2, 5, 8)):
        hinge = turning_about(hip, knee, ankle, positions)
        assert np.all(np.sum(hinge * left, axis=-1) > 0.0), "a knee bends backwards"


@pytest.mark.parametrize("action", ACTIONS)
def test_planted_feet_do_not_move(action: str) -> None:
    field = performance(action, seed=1)
    times = np.arange(0.0, field.end_seconds, 1 / 240)
    contacts = field.contacts(times)
    positions = field.query(times).joint_positions
    both = contacts[1:] & contacts[:-1]
    moved = np.linalg.norm(np.diff(positions[:, FEET], axis=0), axis=-1)
    assert both.any(axis=0).all()
    assert moved[both].max() < 5e-7
    airborne = ~contacts.any(axis=1)
    flies = action in ("run", "jog", "jump", "jump_forward", "jumping_jacks")
    assert airborne.any() == flies


@pytest.mark.parametrize("action", ["walk", "jump", "kick", "punch"])
def test_every_framerate_samples_the_same_motion(action: str) -> None:
    field = performance(action, seed=2)
    fine = to_motion(field, Fraction(120)).joint_positions
    assert np.array_equal(to_motion(field, Fraction(20)).joint_positions, fine[::6])
    assert np.array_equal(to_motion(field, Fraction(60)).joint_positions, fine[::2])


def test_rotations_give_the_positions() -> None:
    motion = to_motion(performance("squat", seed=3), Fraction(30))
    assert motion.local_rotations is not None and motion.root_translation is not None
    again = forward_kinematics(motion.local_rotations, motion.root_translation, motion.skeleton)
    assert np.allclose(again, motion.joint_positions, atol=2e-6)
    assert motion.skeleton.joint_names == SMPL22.joint_names


@pytest.mark.parametrize("action", ["walk", "jump_forward"])
def test_motion_is_continuous(action: str) -> None:
    field = performance(action, seed=4)
    times = np.arange(0.0, field.end_seconds, 1 / 2000)
    step = np.linalg.norm(np.diff(field.query(times).joint_positions, axis=0), axis=-1)
    assert step.max() < 10.0 / 2000


def test_a_walk_goes_where_it_faces() -> None:
    field = performance("walk", seed=5, seconds=6.0)
    times = np.array([2.5, 3.0, 3.5])
    facing = field.trajectory.heading(times)
    before, after = (field.query(times + step).joint_positions[:, 0] for step in (-0.2, 0.2))
    pelvis = (after - before) / 0.4
    along = pelvis[:, 0] * np.sin(facing) + pelvis[:, 2] * np.cos(facing)
    assert np.all(along > 0.5)
    assert np.all(along / np.linalg.norm(pelvis[:, [0, 2]], axis=-1) > 0.97)


def test_turns_go_to_their_side() -> None:
    for action, sign in (("turn_left", 1.0), ("turn_right", -1.0)):
        field = performance(action, seed=6, seconds=6.0)
        ends = field.trajectory.heading(np.array([0.0, 6.0]))
        assert sign * (ends[1] - ends[0]) > 0.5


def test_sampling_at_20_fps_loses_something() -> None:
    field = performance("walk", seed=7)
    fine = to_motion(field, Fraction(120))
    times = fine.timegrid.seconds()
    coarse = to_motion(field, Fraction(20))
    inside = times <= coarse.timegrid.seconds()[-1]
    joint = coarse.joint_positions[:, 20].astype(np.float64)
    interpolated = np.stack(
        [np.interp(times[inside], coarse.timegrid.seconds(), joint[:, axis]) for axis in range(3)], axis=-1
    )
    error = np.linalg.norm(interpolated - fine.joint_positions[inside, 20], axis=-1)
    assert 3e-4 < error.mean() < 2e-2


def test_the_same_generator_gives_the_same_motion() -> None:
    first, second = performance("run", seed=8), performance("run", seed=8)
    times = np.linspace(0.0, 5.0, 50)
    assert np.array_equal(first.query(times).joint_positions, second.query(times).joint_positions)
    assert first.captions == second.captions
    other = performance("run", seed=9)
    assert not np.allclose(first.query(times).joint_positions, other.query(times).joint_positions, atol=0.05)


@settings(max_examples=15)
@example(1_053_060_475, ["walk", "throw"])
@given(st.integers(0, 2**32 - 1), st.lists(st.sampled_from(list(ACTIONS)), min_size=1, max_size=3))
def test_sequences_of_actions(seed: int, actions: list[str]) -> None:
    rng = np.random.default_rng(seed)
    seconds = 2.4 * len(actions) + float(rng.uniform(0, 2))
    field = perform(rng, draw_body(rng, "somebody"), actions, seconds)
    poses = field.query(rng.uniform(0.0, seconds, 40))
    assert np.isfinite(poses.joint_positions).all()
    assert poses.joint_positions[:, :, 1].min() > 0.0
    whole = [caption for caption in field.captions if caption.end_seconds is None]
    pieces = [caption for caption in field.captions if caption.end_seconds is not None]
    assert len(whole) == 3
    assert len(pieces) == (len(actions) if len(actions) > 1 else 0)
    assert all(0.0 <= piece.start_seconds < (piece.end_seconds or 0.0) <= seconds for piece in pieces)
    assert field.action == actions[0]


def test_bodies_have_their_height() -> None:
    for height in (1.5, 1.7, 1.95):
        body = make_body("b", height)
        offsets = body.skeleton.offsets
        head = body.ankle_height + body.leg_length + body.hip_drop + offsets[[3, 6, 9, 12, 15], 1].sum()
        assert 0.90 * height < head < 0.97 * height
    assert make_body("a").skeleton == make_body("b").skeleton
    assert make_body("a", arms=1.05).skeleton != make_body("b").skeleton


def test_refusals() -> None:
    rng = np.random.default_rng(0)
    body = make_body("b")
    with pytest.raises(UsageError, match="no action is called"):
        perform(rng, body, ["fly"], 4.0)
    with pytest.raises(UsageError, match=r"need 4\.0 s"):
        perform(rng, body, ["walk", "bow"], 3.0)
    with pytest.raises(ValueError, match="no channel"):
        Layer("third_arm", smoothstep)
    with pytest.raises(ValueError, match="outside"):
        perform(rng, body, ["bow"], 4.0).query(np.array([4.5]))


def test_curves() -> None:
    u = np.linspace(-0.5, 1.5, 2001)
    for curve, fastest in ((smoothstep, 1.875), (glide, 1 / 0.65)):
        values = curve(u)
        assert values[0] == 0.0 and values[-1] == 1.0
        slope = np.diff(values) / np.diff(u)
        assert slope.min() > -1e-12
        assert slope.max() == pytest.approx(fastest, rel=1e-3)
    noise = band_noise(np.random.default_rng(0), 0.3, 1.0, 20.0)(np.arange(0, 400, 1 / 100))
    assert noise.std() == pytest.approx(0.3, rel=0.03)
