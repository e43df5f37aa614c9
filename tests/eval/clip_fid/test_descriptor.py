"""The kinematic descriptor: known answers of its channels, the variance of its blocks, and what does not change it."""

from fractions import Fraction

import numpy as np
import pytest

from eval.clip_fid import score
from eval.clip_fid.score import (
    NUM_FEATURES,
    REAL,
    SLOW_BANDS,
    Clips,
    KinematicDescriptor,
    Protocol,
    channels,
    describer,
    draw_clips,
    fit_on,
)
from eval.metrics.distributions import Gaussian, fit_gaussian, frechet_distance
from eval.sets.motions import low_pass
from eval.sets.sets import SampleSet
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import rest_positions
from tests.helpers.stamping import stamping

FPS = Fraction(120)
SECONDS = np.arange(480) / 120.0


def still(num_frames: int = 480) -> np.ndarray:
    """The rest pose of the 22 joints, standing still."""
    return np.tile(rest_positions(SMPL22), (num_frames, 1, 1)).astype(np.float64)


@pytest.mark.parametrize("hertz", [1.25, 3.75, 6.5])
@pytest.mark.parametrize("fps", [Fraction(20), FPS])
def test_a_sine_has_its_power_in_its_band(hertz: float, fps: Fraction) -> None:
    rate = float(fps)
    motion = still()
    motion[:, :, 0] += 0.01 * np.sin(2 * np.pi * hertz * np.arange(480) / rate)[:, None]
    power = channels(motion, fps).power[60:-60].mean(axis=0)
    inside = [low <= hertz < high for low, high in SLOW_BANDS].index(True)
    # A second difference has (2 fps sin(pi f / fps))^2 of the amplitude.
    expected = (0.01 * (2 * rate * np.sin(np.pi * hertz / rate)) ** 2) ** 2 / 2
    # Neighbouring bands overlap: in the middle of one its gain is 0.9 or more.
    assert power[inside] == pytest.approx(np.full(5, expected), rel=0.25)
    assert np.delete(power, inside, axis=0).max() < 0.05 * expected


def test_height_and_the_direction_of_time_are_seen() -> None:
    motion = still()
    motion[:, :, 2] += SECONDS[:, None]  # a metre a second forwards
    walk, low, back = (channels(each, FPS) for each in (motion, motion - [0, 0.3, 0], motion[::-1]))
    np.testing.assert_allclose(walk.height - low.height, 0.3, atol=1e-6)
    np.testing.assert_allclose(walk.direction[:, 0], 1.0, atol=1e-6)
    np.testing.assert_allclose(back.direction[:, 0], -1.0, atol=1e-6)


def test_turning_and_moving_the_body_changes_nothing() -> None:
    rng = np.random.default_rng(1)
    motion = still() + 0.05 * np.sin(2 * np.pi * rng.uniform(0.5, 9, (22, 3)) * SECONDS[:, None, None])
    sine, cosine = np.sin(0.7), np.cos(0.7)
    turned = motion @ np.array([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]]) + [3.0, 0.0, -2.0]
    first, second = channels(motion, FPS), channels(turned, FPS)
    for name, values in vars(first).items():
        np.testing.assert_allclose(getattr(second, name), values, rtol=1e-4, atol=1e-6, err_msg=name)


@pytest.fixture(scope="module")
def real() -> SampleSet:
    return stamping(12)


@pytest.fixture(scope="module")
def descriptor(real: SampleSet) -> KinematicDescriptor:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(score, "FIT_CLIPS", 1024)
        return fit_on(real)


def test_blocks_have_the_variance_of_their_weights_on_training_clips(
    real: SampleSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocks = {name: (size, weight, 1e-9) for name, (size, weight, _) in score.BLOCKS.items()}
    monkeypatch.setattr(score, "BLOCKS", blocks)
    monkeypatch.setattr(score, "FIT_CLIPS", 512)
    fitted = fit_on(real)
    order = np.random.default_rng((0, score.FIT_REPLICATION)).permutation(real.num_sequences)
    some = real.select(order)
    rows = describer(some, fitted)(draw_clips(some, Protocol(num_clips=512), score.FIT_REPLICATION, REAL))
    assert rows.shape[1] == NUM_FEATURES
    np.testing.assert_allclose(rows.mean(axis=0), 0.0, atol=1e-9)
    sizes, weights, _ = np.array(list(blocks.values())).T
    starts = (np.cumsum(sizes) - sizes).astype(int)
    np.testing.assert_allclose(np.add.reduceat(rows.var(axis=0), starts), weights)


def test_a_clip_has_the_same_features_in_any_set(real: SampleSet, descriptor: KinematicDescriptor) -> None:
    one, length = real.select([7]), int(real.sequences.num_frames[7])
    start = np.arange(0, length - 24, 5)
    alone = Clips(np.zeros_like(start), start, np.full_like(start, 24))
    among = Clips(alone.sequence + 7, start + real.sequences.start_row[7], alone.num_poses)
    found = describer(one, descriptor)(alone)
    np.testing.assert_allclose(found, describer(real, descriptor)(among), atol=1e-6)
    rows = np.diff(descriptor.running_sums(one).values, axis=0, prepend=0.0)
    means = np.stack([rows[first : first + 24].mean(axis=0) for first in start])
    np.testing.assert_allclose((means[:, :10] - descriptor.centre[:10]) * descriptor.scale[:10], found[:, :10])


def test_noise_above_eight_hertz_neither_wins_nor_loses(real: SampleSet, descriptor: KinematicDescriptor) -> None:
    def gaussian(samples: SampleSet) -> Gaussian:
        clips = draw_clips(samples, Protocol(num_clips=600), 0, REAL)
        return fit_gaussian(describer(samples, descriptor)(clips))

    rng = np.random.default_rng(3)
    slow = [low_pass(take, 120.0, 8.0) for take in real.sequences]
    noise = [(0.001 * rng.standard_normal(take.shape)).astype(np.float32) for take in slow]
    noisy = [take + each - low_pass(each, 120.0, 20.0) for take, each in zip(slow, noise, strict=True)]
    sets = [real.with_positions(takes) for takes in (slow, noisy)]
    plain, other = (frechet_distance(gaussian(real), gaussian(each)) for each in sets)
    assert other == pytest.approx(plain, rel=0.02)


def test_another_framerate_is_refused(real: SampleSet, descriptor: KinematicDescriptor) -> None:
    with pytest.raises(ValueError, match="fitted at 120"):
        describer(real.with_positions(list(real.sequences), fps=Fraction(60)), descriptor)
