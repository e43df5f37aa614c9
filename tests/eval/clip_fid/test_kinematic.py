"""The kinematic descriptor: its blocks, and that noise above 8 Hz neither wins nor loses."""

from fractions import Fraction

import numpy as np
import pytest

from eval.clip_fid import features, kinematic
from eval.clip_fid.clips import REAL, Protocol, describe_clips, draw_clips, place_clips, readable
from eval.clip_fid.features import fit_on
from eval.clip_fid.kinematic import BLOCKS, NUM_FEATURES, WEIGHTS, KinematicDescriptor, fit_kinematic
from eval.metrics.distributions import Gaussian, fit_gaussian, frechet_distance
from eval.sets.motions import low_pass
from eval.sets.sets import SampleSet, sample_set
from motionkit.core.skeleton import SMPL22

FPS = Fraction(120)
PROTOCOL = Protocol(num_clips=600)


def stamping(num_takes: int = 12, seed: int = 0) -> SampleSet:
    """Takes of a body that stamps: above 12 Hz it shakes after each stamp and hardly between, with noise throughout."""
    rng, rest = np.random.default_rng(seed), np.zeros((22, 3))
    for joint, parent in enumerate(SMPL22.parents[1:], start=1):
        rest[joint] = rest[parent] + SMPL22.offsets[joint]
    takes, seconds = [], np.arange(480) / 120.0
    for _ in range(num_takes):
        beat = rng.uniform(1.0, 1.6)
        phase = 2 * np.pi * (beat * seconds + rng.uniform())
        sway = np.stack([0.2 * np.sin(phase), 0.1 * np.abs(np.sin(phase)), 0.05 * np.cos(phase)], axis=-1)
        shake = np.exp(4 * (np.cos(2 * phase) - 1)) * np.sin(
            2 * np.pi * rng.uniform(16, 50) * seconds + rng.uniform(0, 6)
        )
        take = rest + rng.uniform(0.5, 1.5, (22, 1)) * sway[:, None] + 0.003 * shake[:, None, None]
        takes.append((take + 0.0001 * rng.standard_normal(take.shape)).astype(np.float32))
    return sample_set("stamping", FPS, takes, [str(index) for index in range(num_takes)])


@pytest.fixture(scope="module")
def real() -> SampleSet:
    return stamping()


@pytest.fixture(scope="module")
def descriptor(real: SampleSet) -> KinematicDescriptor:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(features, "FIT_CLIPS", 1024)
        return fit_on(real)


def described(samples: SampleSet, descriptor: KinematicDescriptor, replication: int = 0) -> np.ndarray:
    places = place_clips(draw_clips(PROTOCOL, FPS, replication, REAL), samples)
    return describe_clips(readable(samples, descriptor), places, descriptor)


def gaussian(samples: SampleSet, descriptor: KinematicDescriptor) -> Gaussian:
    return fit_gaussian(described(samples, descriptor))


def test_blocks_have_the_variance_of_their_weights_on_training_clips(
    real: SampleSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kinematic, "LEAST_LOG_SPREAD", 1e-9)
    monkeypatch.setattr(kinematic, "LEAST_SPREADS", dict.fromkeys(kinematic.LEAST_SPREADS, 1e-9))
    monkeypatch.setattr(features, "FIT_CLIPS", 512)
    fitted = fit_on(real)
    order = np.random.default_rng((0, features.FIT_REPLICATION)).permutation(real.num_sequences)
    some = real.select(order)
    places = place_clips(draw_clips(Protocol(num_clips=512), FPS, features.FIT_REPLICATION, REAL), some)
    rows = describe_clips(readable(some, fitted), places, fitted)
    assert rows.shape[1] == NUM_FEATURES
    for name, block in BLOCKS.items():
        assert rows[:, block].var(axis=0).sum() == pytest.approx(WEIGHTS[name]), name
        np.testing.assert_allclose(rows[:, block].mean(axis=0), 0.0, atol=1e-9)


def test_a_clip_has_the_same_features_in_any_set(real: SampleSet, descriptor: KinematicDescriptor) -> None:
    whole, one = descriptor.frames(real), descriptor.frames(real.select([7]))
    np.testing.assert_allclose(one[0], whole[7], rtol=1e-6, atol=1e-7)
    clips = whole.clips(np.arange(40), 24)
    np.testing.assert_allclose(descriptor.describe(clips[9:11], FPS), descriptor.describe(clips, FPS)[9:11], atol=1e-12)


def test_noise_above_eight_hertz_neither_wins_nor_loses(real: SampleSet, descriptor: KinematicDescriptor) -> None:
    rng = np.random.default_rng(3)
    slow = [low_pass(take[None], 120.0, 8.0)[0] for take in real.sequences]
    noise = [0.001 * rng.standard_normal(take.shape) for take in slow]
    fast = [each - low_pass(each[None], 120.0, 20.0)[0] for each in noise]
    sets = [
        real.with_positions(name, FPS, [take.astype(np.float32) for take in takes])
        for name, takes in {"slow": slow, "noisy": [a + b for a, b in zip(slow, fast, strict=True)]}.items()
    ]
    reference = gaussian(real, descriptor)
    plain, noisy = (frechet_distance(reference, gaussian(each, descriptor)) for each in sets)
    assert noisy == pytest.approx(plain, rel=0.02)


def test_other_framerates_and_no_motion_are_refused(real: SampleSet, descriptor: KinematicDescriptor) -> None:
    with pytest.raises(ValueError, match="fitted at 120"):
        descriptor.frames(real.with_positions("60", Fraction(60), list(real.sequences)))
    with pytest.raises(ValueError, match="at least one motion"):
        fit_kinematic([], FPS)
