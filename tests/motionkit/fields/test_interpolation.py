"""Interpolators: what each restores exactly, what is true of all, and how they look beside scipy's."""

import re
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

import motionkit as mk
from motionkit.core import kinematics
from motionkit.fields.interpolation import INTERPOLATORS, Method, Settling, interpolate
from motionkit.fields.motion_field import MotionEncoder, MotionField, Observation, Poses, to_motion
from motionkit.io.bvh import write_bvh
from tests.helpers.analytic import analytic_motion
from tests.helpers.pages import run_page
from tests.helpers.repository import REPOSITORY
from tests.helpers.turning_body import random_motion
from tests.helpers.velocities import joint_velocities

METHODS: list[Method] = list(INTERPOLATORS)
SMOOTH: list[Method] = ["catmull-rom", "cubic", "rotation-catmull-rom", "squad", "rotation-cubic"]
ON_ROTATIONS: list[Method] = ["slerp", "rotation-catmull-rom", "squad", "rotation-cubic"]
NTSC = Fraction(30000, 1001)


def uneven(motion: mk.Motion, seed: int = 0) -> Observation:
    """About half the frames of a motion, the first and the last among them."""
    kept = np.random.default_rng(seed).uniform(size=motion.num_frames) < 0.5
    kept[[0, -1]] = True
    return Observation.of(motion, kept)


def turn_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angles between rotations, radians."""
    return np.asarray(
        (Rotation.from_quat(a.reshape(-1, 4), scalar_first=True).inv()
         * Rotation.from_quat(b.reshape(-1, 4), scalar_first=True)).magnitude()
    )  # fmt: skip


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("rotations", [True, False])
def test_observed_frames_are_exact_at_even_and_uneven_times(method: Method, rotations: bool) -> None:
    for observation in (
        Observation.of(random_motion(0, fps=NTSC, rotations=rotations)),
        uneven(random_motion(1, rotations=rotations)),
    ):
        poses = INTERPOLATORS[method].encode(observation).query(observation.times_seconds)
        assert np.abs(poses.joint_positions - observation.poses.joint_positions).max() < 1e-6
        if poses.local_rotations is not None:
            assert observation.poses.local_rotations is not None and observation.poses.root_translation is not None
            assert turn_between(poses.local_rotations, observation.poses.local_rotations).max() < 1e-5
            assert poses.root_translation is not None
            assert np.abs(poses.root_translation - observation.poses.root_translation).max() < 1e-6
        else:
            assert method not in ON_ROTATIONS or not rotations


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("rotations", [True, False])
def test_many_motions_at_once_are_each_as_alone(method: Method, rotations: bool) -> None:
    motions = [random_motion(seed, rotations=rotations) for seed in range(3)]
    kept = np.flatnonzero(np.random.default_rng(1).uniform(size=motions[0].num_frames) < 0.5)
    observations = [Observation.of(motion).rows(kept) for motion in motions]
    times = np.concatenate((motions[0].timegrid.seconds(), observations[0].times_seconds[:1] - [0.05, 0.2]))
    before, after = np.ptp(times), np.ptp(times)
    together = INTERPOLATORS[method].query_many(observations, times)
    for observation, found in zip(observations, together, strict=True):
        field = INTERPOLATORS[method].encode(observation, before_seconds=before, after_seconds=after)
        expected = field.query(times)
        assert (found.root_translation is None) == (expected.root_translation is None)
        assert np.abs(found.joint_positions - expected.joint_positions).max() < 1e-6
        if expected.local_rotations is not None:
            assert found.local_rotations is not None
            assert turn_between(found.local_rotations, expected.local_rotations).max() < 1e-5


@pytest.mark.parametrize("method", METHODS)
def test_the_domain_is_the_observed_span(method: Method) -> None:
    field = interpolate(random_motion(5, num_frames=4), method)
    assert field.end_seconds - field.start_seconds == pytest.approx(0.1)
    for outside in (1.36, np.nan):
        with pytest.raises(ValueError, match=str(outside)):
            field.query(np.array([1.3, outside]))
    with pytest.raises(ValueError, match="-1"):
        INTERPOLATORS[method].encode(Observation.of(random_motion(5)), before_seconds=-1.0)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("num_frames", [1, 2, 3])
def test_very_short_motions(method: Method, num_frames: int) -> None:
    motion = random_motion(6, num_frames=num_frames)
    sampled = to_motion(interpolate(motion, method), Fraction(90))
    assert sampled.num_frames == 3 * (num_frames - 1) + 1
    assert np.allclose(sampled.joint_positions[::3], motion.joint_positions, atol=1e-6)
    beyond = INTERPOLATORS[method].encode(Observation.of(motion), after_seconds=1.0)
    later = beyond.query(np.array([beyond.end_seconds])).joint_positions
    assert np.isfinite(later).all()
    if num_frames == 1:
        assert np.allclose(later, motion.joint_positions, atol=1e-6)


def test_observations_are_checked() -> None:
    motion = random_motion(8, num_frames=3)
    for times in ([0.0, 0.0, 1.0], [0.0, 2.0, 1.0], [0.0, np.nan, 1.0], [0.0, 1.0]):
        with pytest.raises(ValueError):
            Observation(np.array(times), Poses.of(motion), mk.SMPL22)
    for mask in (np.zeros(3, dtype=np.bool_), np.ones(4, dtype=np.bool_)):
        with pytest.raises(ValueError):
            Observation.of(motion, mask)
    unseen = motion.joint_positions.copy()
    unseen[1, 4, 2] = np.nan
    with pytest.raises(ValueError, match="pose 1"):
        Observation(motion.timegrid.seconds(), Poses(unseen, motion.local_rotations), mk.SMPL22)


def polynomial_motion(degree: int, fps: int = 10) -> tuple[mk.Motion, "np.ndarray"]:
    coefficients = np.random.default_rng(degree).normal(size=(degree + 1, 22, 3))
    motion = mk.Motion(polynomial(coefficients, np.arange(12) / fps), mk.SMPL22, mk.TimeGrid(Fraction(fps), 12))
    return motion, coefficients


def polynomial(coefficients: np.ndarray, times: np.ndarray) -> np.ndarray:
    powers = times[:, None] ** np.arange(len(coefficients))
    return np.einsum("tk,kjc->tjc", powers, coefficients).astype(np.float32)


@pytest.mark.parametrize(("method", "degree"), [("linear", 1), ("catmull-rom", 2), ("cubic", 3)])
def test_polynomials_that_are_restored(method: Method, degree: int) -> None:
    motion, coefficients = polynomial_motion(degree)
    # Catmull-Rom's rates at the two ends are those of the outermost steps.
    times = np.linspace(0.1, 1.0, 40) if method == "catmull-rom" else np.linspace(0, 1.1, 40)
    for observation in (Observation.of(motion), Observation.of(motion, np.arange(12) % 5 != 2)):
        inner = times[(times >= observation.times_seconds[1]) & (times <= observation.times_seconds[-2])]
        chosen = inner if method == "catmull-rom" else times
        found = INTERPOLATORS[method].encode(observation).query(chosen).joint_positions
        assert np.allclose(found, polynomial(coefficients, chosen), atol=1e-5)


def spinning(times: np.ndarray) -> np.ndarray:
    """Joint j turns about its own axis at a constant rate; quaternions."""
    rates = np.random.default_rng(9).normal(size=(22, 3))
    turns = Rotation.from_rotvec((times[:, None, None] * rates).reshape(-1, 3))
    return np.asarray(turns.as_quat(scalar_first=True).reshape(len(times), 22, 4).astype(np.float32))


@pytest.mark.parametrize("method", ON_ROTATIONS)
def test_constant_rates_of_turning_are_restored_and_continued(method: Method) -> None:
    kept = np.sort(np.random.default_rng(1).choice(np.arange(30), 12, replace=False)) / 10
    root = (np.outer(kept, [1.0, 0.5, -0.2]) + 0.3).astype(np.float32)
    local = spinning(kept)
    positions = kinematics.forward_kinematics(local, root, mk.SMPL22)
    field = INTERPOLATORS[method].encode(
        Observation(kept, Poses(positions, local, root), mk.SMPL22), before_seconds=0.5, after_seconds=0.5
    )
    times = np.linspace(field.start_seconds, field.end_seconds, 60)
    poses = field.query(times)
    assert poses.local_rotations is not None
    assert turn_between(poses.local_rotations, spinning(times)).max() < 2e-5
    truth = kinematics.forward_kinematics(
        spinning(times), (np.outer(times, [1.0, 0.5, -0.2]) + 0.3).astype(np.float32), mk.SMPL22
    )
    assert np.allclose(poses.joint_positions, truth, atol=2e-5)


def test_slerp_agrees_with_scipy() -> None:
    motion = random_motion(10)
    for observation in (Observation.of(motion), uneven(motion)):
        field = INTERPOLATORS["slerp"].encode(observation)
        times = np.random.default_rng(1).uniform(field.start_seconds, field.end_seconds, 50)
        poses = field.query(times)
        given, root = observation.poses.local_rotations, observation.poses.root_translation
        assert given is not None and root is not None
        expected = np.empty((50, 22, 4), np.float32)
        for joint in range(22):
            rotations = Rotation.from_quat(given[:, joint].astype(np.float64), scalar_first=True)
            expected[:, joint] = Slerp(observation.times_seconds, rotations)(times).as_quat(scalar_first=True)
        assert poses.local_rotations is not None and poses.root_translation is not None
        assert turn_between(poses.local_rotations, expected).max() < 1e-5
        path = [np.interp(times, observation.times_seconds, root[:, axis]) for axis in range(3)]
        assert np.allclose(poses.root_translation, np.stack(path, -1), atol=1e-6)
        positions = kinematics.forward_kinematics(expected, poses.root_translation, mk.SMPL22)
        assert np.allclose(poses.joint_positions, positions, atol=1e-5)


@pytest.mark.parametrize("method", SMOOTH)
def test_velocity_is_continuous_at_every_frame_and_beyond_the_ends(method: Method) -> None:
    observation = uneven(random_motion(12, num_frames=30))
    knots = observation.times_seconds

    def jump(method: Method, step: float) -> float:
        """Largest difference of the slopes shortly after and shortly before a frame, m/s."""
        field = INTERPOLATORS[method].encode(observation, before_seconds=0.1, after_seconds=0.1)
        times = np.concatenate([knots + offset * step for offset in (-2, -1, 1, 2)])
        before, left, right, after = np.split(field.query(times).joint_positions.astype(np.float64), 4)
        return float(np.abs((after - right) - (left - before)).max() / step)

    # Where acceleration is finite the difference vanishes with the step; a kink keeps it.
    assert jump(method, 1e-3) < 0.15 * jump(method, 1e-2) + 0.05
    assert jump("linear", 1e-3) > 0.8 * jump("linear", 1e-2) > 1.0


def test_hold_stands_still_and_the_others_go_on() -> None:
    motion = random_motion(13)
    observation = Observation.of(motion)
    times = np.array([1.25, 1.25 + 0.9 / 30, 1.25 + 1 / 30])
    held = interpolate(motion, "hold").query(times)
    assert np.array_equal(held.joint_positions, motion.joint_positions[[0, 0, 1]])
    end = observation.end_seconds
    later = np.array([end, end + 0.1, end + 0.2])
    for method in METHODS:
        field = INTERPOLATORS[method].encode(observation, after_seconds=0.2)
        path = field.query(later).joint_positions[:, 0]
        moved = np.diff(path, axis=0)
        assert np.allclose(moved[0], moved[1], atol=1e-6)
        assert bool(np.all(moved == 0)) == (method == "hold")
        if method in ON_ROTATIONS:
            positions = field.query(later).joint_positions
            bones = np.linalg.norm(positions[:, 1:] - positions[:, list(mk.SMPL22.parents[1:])], axis=-1)
            assert np.allclose(bones, bones[0], atol=1e-6)


NAMES = ("slerp", "squad", "rotation-cubic")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("rotations", [True, False])
def test_settling_keeps_what_lies_between_frames_and_comes_to_rest(name: str, rotations: bool) -> None:
    motion = random_motion(2)
    if not rotations:
        motion = replace(motion, local_rotations=None, root_translation=None)
    encoder, plain = Settling(INTERPOLATORS[name]), INTERPOLATORS[name].encode(Observation.of(motion))
    field = encoder.encode(Observation.of(motion), before_seconds=9.0, after_seconds=9.0)
    assert isinstance(encoder, MotionEncoder) and encoder.name == name and isinstance(field, MotionField)
    times = np.random.default_rng(0).uniform(plain.start_seconds, plain.end_seconds, 50)
    np.testing.assert_array_equal(field.query(times).joint_positions, plain.query(times).joint_positions)
    first, last = float(motion.timegrid.seconds()[0]), float(motion.timegrid.seconds()[-1])
    for end, inwards in ((first, 1.0), (last, -1.0)):
        inside = joint_velocities(field, np.array([end + 2e-4 * inwards]), step_seconds=1e-4)
        outside = joint_velocities(field, np.array([end - 2e-4 * inwards]), step_seconds=1e-4)
        assert np.abs(inside - outside).max() < 0.1 * np.abs(inside).max()
    far = field.query(np.array([first - 9.0, first - 8.0, last + 8.0, last + 9.0]))
    assert (far.local_rotations is not None) == rotations
    np.testing.assert_allclose(far.joint_positions[0], far.joint_positions[1], atol=1e-3)
    np.testing.assert_allclose(far.joint_positions[2], far.joint_positions[3], atol=1e-3)


def test_the_page_lists_every_interpolator_and_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = REPOSITORY / "docs" / "motion-fields.md"
    listed = re.findall(r"^\| `([a-z-]+)` \| .*\| .*\|$", page.read_text(), re.MULTILINE)
    assert set(INTERPOLATORS) <= set(listed)
    monkeypatch.chdir(tmp_path)
    write_bvh(to_motion(analytic_motion("walk", 3.0), Fraction(30)), Path("walk.bvh"))
    names = run_page(page, lambda words: None)
    assert names["smooth"].fps == 120 and names["film"].fps == Fraction(24000, 1001)
    assert names["longer"].num_frames == names["motion"].num_frames + 15
    assert names["filled"].local_rotations is not None
