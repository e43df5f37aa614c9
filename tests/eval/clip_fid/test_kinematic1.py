"""The kinematic descriptor: invariances, known answers of every block, independence of batches."""

from fractions import Fraction

import numpy as np
import pytest

from eval.clip_fid import kinematic1
from eval.clip_fid.kinematic1 import BLOCKS, KinematicDescriptor, fit_kinematic
from eval.sets.corruptions import turn

FPS = Fraction(60)


def walks(num_clips: int, num_poses: int, fps: Fraction = FPS, seed: int = 0) -> np.ndarray:
    """Smooth bodies whose joints swing about a rigid pose while the whole drifts; exact at any framerate."""
    rng = np.random.default_rng(seed)
    rest = np.random.default_rng(99).normal(size=(22, 3)) * [0.3, 0.5, 0.3]
    rest[[2, 17], 0], rest[[1, 16], 0] = -0.2, 0.2
    phase, rate = rng.uniform(0, 6, (num_clips, 1, 22, 3)), rng.uniform(3, 9, (num_clips, 1, 22, 3))
    size = 0.1 * np.exp(rng.normal(0.0, 0.7, (num_clips, 1, 22, 1)) + rng.normal(0.0, 0.7, (num_clips, 1, 1, 1)))
    seconds = np.arange(num_poses)[None, :, None, None] / float(fps)
    velocity = rng.normal(size=(num_clips, 1, 1, 3)) * [1, 0, 1]
    return (rest + size * np.sin(rate * seconds + phase) + velocity * seconds).astype(np.float32)


@pytest.fixture(scope="module")
def descriptor() -> KinematicDescriptor:
    return fit_kinematic([walks(200, m, seed=m) for m in (16, 32, 64)], FPS)


def test_blocks_have_equal_variance_and_mean_zero_on_the_clips_of_the_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kinematic1, "LEAST_LOG_SPREAD", 1e-6)
    monkeypatch.setattr(kinematic1, "LEAST_POSE_SPREAD", 1e-6)
    groups = [walks(200, m, seed=m) for m in (16, 32, 64)]
    fitted = fit_kinematic(groups, FPS)
    rows = np.concatenate([fitted.describe(clips, FPS) for clips in groups])
    np.testing.assert_allclose(rows.mean(axis=0), 0.0, atol=1e-10)
    for block in BLOCKS.values():
        assert rows[:, block].var(axis=0).sum() == pytest.approx(1.0)
    assert rows.shape[1] == sum(block.stop - block.start for block in BLOCKS.values()) == kinematic1.NUM_FEATURES


def test_a_clip_has_the_same_features_in_any_batch(descriptor: KinematicDescriptor) -> None:
    clips = walks(600, 24, seed=5)
    whole = descriptor.describe(clips, FPS)
    np.testing.assert_allclose(descriptor.describe(clips[417:419], FPS), whole[417:419], rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(descriptor.describe(clips[::-1], FPS), whole[::-1], rtol=1e-10, atol=1e-12)


def test_turning_and_moving_the_body_changes_nothing(descriptor: KinematicDescriptor) -> None:
    clips = walks(50, 32, seed=6).astype(np.float64)
    moved = turn(clips, np.linspace(0, 6, 50)) + np.array([3.0, 0.0, -2.0])
    np.testing.assert_allclose(descriptor.describe(moved, FPS), descriptor.describe(clips, FPS), atol=1e-9)


def test_quantities_are_per_second() -> None:
    """One motion's poses, speed, acceleration and slip agree at 60 and 240 fps (slip's minima depend on luck)."""
    short, long = walks(20, 61, Fraction(60), seed=7), walks(20, 241, Fraction(240), seed=7)
    mean, components = np.zeros(63), np.eye(10, 63)
    a = kinematic1._raw_features(short, Fraction(60), mean, components)
    b = kinematic1._raw_features(long, Fraction(240), mean, components)
    for block in (BLOCKS["pose"], BLOCKS["speed"], BLOCKS["level"], slice(61, 64)):
        np.testing.assert_allclose(a[:, block], b[:, block], atol=0.05)


@pytest.mark.parametrize(("relative_frequency", "band"), [(0.1, 0), (0.25, 1), (0.42, 2), (0.6, 3), (0.9, 4)])
def test_an_oscillation_falls_into_its_band(relative_frequency: float, band: int) -> None:
    """A joint swinging at f has acceleration (2πf)²·a; its mean square must appear in f's band and nowhere else."""
    clips = np.zeros((1, 66, 22, 3))
    frequency = relative_frequency * float(FPS) / 2
    clips[0, :, 0, 1] = 0.01 * np.sin(2 * np.pi * frequency * np.arange(66) / float(FPS))
    raw = kinematic1._raw_features(clips, FPS, np.zeros(63), np.eye(10, 63))
    root_bands = np.exp(raw[0, BLOCKS["acceleration"]].reshape(5, 5)[:, 0])
    step = 2 * np.sin(np.pi * frequency / float(FPS)) * float(FPS)
    assert np.argmax(root_bands) == band
    assert root_bands[band] == pytest.approx(0.01 * step**2 / np.sqrt(2), rel=0.05)
    assert np.delete(root_bands, band).max() < 0.3 * root_bands[band]


def test_the_level_of_a_motion_that_is_bent_at_a_few_poses_is_that_between_them() -> None:
    """Straight lines between every eighth pose: a quarter of the frames has a kink, three quarters have none."""
    knots = np.random.default_rng(3).normal(size=(9, 22, 3))
    time = np.arange(65) / 8
    bent = np.stack([np.interp(time, np.arange(9), column) for column in knots.reshape(9, -1).T], axis=1)
    clips = np.stack((bent.reshape(65, 22, 3), np.random.default_rng(4).normal(size=(65, 22, 3))))
    raw = kinematic1._raw_features(clips, FPS, np.zeros(63), np.eye(10, 63))[:, BLOCKS["level"]]
    np.testing.assert_allclose(raw[0, :5], np.log(kinematic1.ACCELERATION_FLOOR), atol=1e-6)
    assert raw[1].min() > 8.0


def test_slip_is_the_drift_of_the_steadier_foot() -> None:
    """Both feet planted, body drifting at 5 cm/s; one foot swinging besides leaves the steadiest as it is."""
    seconds = np.arange(40) / float(FPS)
    clips = np.zeros((2, 40, 22, 3))
    clips[:, :, :, 0] = 0.05 * seconds[None, :, None]
    clips[1, :, [7, 10], 0] += np.sin(9 * seconds)
    raw = kinematic1._raw_features(clips, FPS, np.zeros(63), np.eye(10, 63))[:, BLOCKS["slip"]]
    expected = np.log(0.05 + kinematic1.SLIP_FLOOR)
    np.testing.assert_allclose(raw[0], expected, atol=1e-9)
    np.testing.assert_allclose(raw[1, 2:4], expected, atol=1e-9)
    assert raw[1, 4] > -1.0


def test_numbers_that_hardly_vary_are_not_blown_up() -> None:
    """Clips that stand still: any number of theirs is constant, and a moving clip stays at a finite distance."""
    still = np.repeat(walks(50, 1), 32, axis=1)
    fitted = fit_kinematic([still], FPS)
    assert fitted.scale.max() <= 1 / kinematic1.LEAST_POSE_SPREAD / np.sqrt(20)
    assert np.abs(fitted.describe(walks(50, 32), FPS)).max() < 100


def test_other_clips_make_another_fit(descriptor: KinematicDescriptor) -> None:
    assert fit_kinematic([walks(200, 16, seed=1)], FPS).fingerprint != descriptor.fingerprint


def test_refusals(descriptor: KinematicDescriptor) -> None:
    with pytest.raises(ValueError, match="fitted at 60 fps"):
        descriptor.describe(walks(2, 20), Fraction(120))
    with pytest.raises(ValueError, match="21 joints"):
        descriptor.describe(walks(2, 20)[:, :, :21], FPS)
    with pytest.raises(ValueError, match="7 poses"):
        descriptor.describe(walks(2, 7), FPS)
    with pytest.raises(ValueError, match="two clips"):
        fit_kinematic([walks(1, 20)], FPS)
