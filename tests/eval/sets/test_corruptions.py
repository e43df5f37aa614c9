import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eval.sets import damage as corruptions
from eval.sets.motions import low_pass
from motionkit.core.kinematics import forward_kinematics, quaternion_slerp
from motionkit.core.skeleton import SMPL22
from tests.helpers.bones import bone_lengths

FAMILIES = {family.name: family for family in corruptions.families()}
PARENTS = np.array(SMPL22.parents[1:])


def swinging(num_frames: int = 120, fps: float = 60.0, clips: int = 3) -> np.ndarray:
    """Clips in which every joint swings at its own frequency while the root walks ahead."""
    rng = np.random.default_rng(5)
    seconds = np.arange(num_frames) / fps
    frequency, phase = rng.uniform(0.5, 8.0, (2, clips, 1, SMPL22.num_joints))
    angle = 0.4 * np.sin(2 * np.pi * frequency * seconds[:, None] + phase)
    rotations = np.stack((np.cos(angle / 2), np.sin(angle / 2), 0 * angle, 0 * angle), -1).astype(np.float32)
    root = np.stack((0.1 * seconds, 0.9 + 0 * seconds, 1.2 * seconds), -1).astype(np.float32)
    return np.stack([forward_kinematics(rotation, root, SMPL22) for rotation in rotations])


@pytest.mark.parametrize("name", FAMILIES)
def test_damage_grows_with_strength_and_keeps_shape_and_dtype(name: str) -> None:
    family, clips = FAMILIES[name], swinging()
    damage = [
        float(np.abs(family.corrupt(clips, 60.0, level, np.random.default_rng(0)) - clips).mean())
        for level in family.levels_at(60.0)
    ]
    assert len(damage) >= 4 and damage[0] > 0
    assert damage == sorted(damage)
    assert family.corrupt(clips, 60.0, family.levels[-1], np.random.default_rng(0)).dtype == np.float32


@pytest.mark.parametrize("name", FAMILIES)
def test_a_clip_in_a_batch_of_strengths_equals_the_same_clip_alone(name: str) -> None:
    family, clips = FAMILIES[name], swinging()
    strengths = family.draw(np.random.default_rng(1), 60.0, len(clips))
    # Draws are made clip by clip in order, so the first clip of a batch sees the same ones as a clip alone.
    together = family.corrupt(clips, 60.0, strengths, np.random.default_rng(0))
    first = family.corrupt(clips[0], 60.0, float(strengths[0]), np.random.default_rng(0))
    assert together.shape == clips.shape and first.shape == clips[0].shape
    assert np.allclose(together[0], first, atol=1e-6)


@pytest.mark.parametrize("name", FAMILIES)
@pytest.mark.parametrize("fps", [20.0, 40.0, 60.0, 120.0])
def test_severity_rises_with_the_levels_and_is_zero_where_nothing_changes(name: str, fps: float) -> None:
    family = FAMILIES[name]
    severity = family.severity(np.array(family.levels_at(fps)), fps)
    assert np.all(np.diff(severity) > 0) and np.all(severity > 0)
    clean = 0.0 if family.kind == "amplitude" else fps * family.clean_at
    assert family.severity(np.array([clean]), fps)[0] == 0.0
    drawn = family.draw(np.random.default_rng(2), fps, 1000)
    assert np.all(family.severity(drawn, fps) >= -1e-12)


def test_upsampling_by_slerp_keeps_bones_rigid_and_by_linear_interpolation_does_not() -> None:
    clips = swinging(fps=240.0)
    slerped = corruptions.upsample_slerp(clips, 240.0, 12.0, np.random.default_rng(0))
    straight = corruptions.upsample_linear(clips, 240.0, 12.0, np.random.default_rng(0))
    change = [
        np.abs(bone_lengths(upsampled, SMPL22) - bone_lengths(clips, SMPL22)).max() for upsampled in (slerped, straight)
    ]
    assert change[0] < 1e-3 < 1e-2 < change[1]


def test_slerp_of_a_single_turning_bone_agrees_with_quaternions() -> None:
    angle = np.array([0.0, 0.9])
    quaternions = np.stack((np.cos(angle / 2), 0 * angle, 0 * angle, np.sin(angle / 2)), -1)
    fraction = np.linspace(0, 1, 31)
    turned = quaternion_slerp(quaternions[:1].repeat(31, 0), quaternions[1:].repeat(31, 0), fraction)
    expected = np.stack((1 - 2 * turned[:, 3] ** 2, 2 * turned[:, 0] * turned[:, 3], 0 * fraction), -1)
    positions = np.zeros((31, 2, 3))
    positions[0, 1], positions[-1, 1] = expected[0], expected[-1]
    # One kept pose a second, thirty frames a second: only the first and the last pose, whatever the phase.
    result = corruptions.upsample_slerp(positions, 30.0, 1e-6, np.random.default_rng(3), parents=(-1, 0))
    assert np.allclose(result[:, 1], expected, atol=1e-9)


def test_sliding_is_a_horizontal_drift_at_the_stated_speed() -> None:
    clips = swinging()
    drift = (corruptions.slide(clips, 60.0, np.array([0.1, 0.2, 0.3]), np.random.default_rng(0)) - clips)[:, -1]
    assert np.allclose(drift[..., 1], 0, atol=1e-6)
    speed = np.linalg.norm(drift, axis=-1) / (119 / 60)
    assert np.allclose(speed, np.array([0.1, 0.2, 0.3])[:, None], atol=1e-5)


def test_jitter_has_the_stated_deviation() -> None:
    clips = np.zeros((4, 500, 22, 3))
    noise = corruptions.jitter(clips, 60.0, np.array([1e-3, 2e-3, 5e-3, 1e-2]), np.random.default_rng(0))
    assert np.allclose(noise.std(axis=(1, 2, 3)), [1e-3, 2e-3, 5e-3, 1e-2], rtol=0.02)


@pytest.mark.parametrize(("frequency", "gain"), [(1.0, 1.0), (5.0, 0.5), (15.0, 0.0)])
def test_low_pass_gain_on_sine_waves(frequency: float, gain: float) -> None:
    seconds = np.arange(600) / 100
    wave = np.sin(2 * np.pi * frequency * seconds)[:, None, None] * np.ones((1, 2, 3))
    passed = low_pass(wave, 100.0, 5.0)
    assert np.abs(passed[100:-100]).max() == pytest.approx(gain, abs=1e-3)


@given(cutoff=st.floats(1.0, 40.0), num_frames=st.integers(1, 40), seed=st.integers(0, 2**16))
@settings(max_examples=40)
def test_low_pass_leaves_uniform_motion_alone(cutoff: float, num_frames: int, seed: int) -> None:
    start, velocity = np.random.default_rng(seed).normal(size=(2, 4, 3))
    uniform = start + velocity * np.arange(num_frames)[:, None, None] / 100
    assert np.allclose(low_pass(uniform, 100.0, cutoff), uniform, atol=1e-9)


def test_flat_transforms_keep_distances_and_differences() -> None:
    clips = swinging()
    turned = corruptions.turn(clips, np.array([0.3, 1.0, -2.0]))
    moved = corruptions.translate(clips, np.array([[1.0, 2.0], [0.0, 0.0], [-3.0, 4.0]]))
    assert np.allclose(bone_lengths(turned, SMPL22), bone_lengths(clips, SMPL22), atol=1e-5)
    assert np.allclose(turned[..., 1], clips[..., 1])
    assert np.allclose(np.diff(moved, axis=1), np.diff(clips, axis=1), atol=1e-5)
    assert np.allclose(corruptions.turn(turned, np.array([-0.3, -1.0, 2.0])), clips, atol=1e-5)


def test_a_shift_keeps_what_lies_below_the_nyquist_frequency() -> None:
    frames = np.arange(600)
    for cycles_per_frame in (0.05, 0.3, 0.45, 0.475):
        wave = np.cos(2 * np.pi * cycles_per_frame * frames)[:, None, None] * np.ones((1, 2, 3))
        expected = np.cos(2 * np.pi * cycles_per_frame * (frames + 0.5))
        found = corruptions.shift_between_frames(wave, 0.5)[100:-100, 0, 0]
        assert np.abs(found - expected[100:-100]).max() < 0.01
