"""The kinematic descriptor: its blocks, its timing, and that a score does not fall by noise that follows nothing."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from eval.clip_fid import features, kinematic
from eval.clip_fid.clips import REAL, Protocol, describe_clips, draw_clips, num_features, place_clips, readable
from eval.clip_fid.features import fit_on, fit_version_1_on
from eval.clip_fid.kinematic import WEIGHTS, KinematicDescriptor, fit_kinematic, load_kinematic
from eval.metrics.gaussian import Gaussian, fit_gaussian
from eval.sets.sets import SampleSet, sample_set
from motionkit.core.errors import DamagedFileError
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
    for name in ("LEAST_LOG_SPREAD", "LEAST_POSE_SPREAD"):
        monkeypatch.setattr(kinematic, name, 1e-9)
    monkeypatch.setattr(features, "FIT_CLIPS", 512)
    fitted = fit_on(real)
    order = np.random.default_rng((0, features.FIT_REPLICATION)).permutation(real.num_sequences)
    some = real.select(order)
    places = place_clips(draw_clips(Protocol(num_clips=512), FPS, features.FIT_REPLICATION, REAL), some)
    rows = describe_clips(readable(some, fitted), places, fitted)
    assert rows.shape[1] == fitted.num_distance + 2 == num_features(fitted, real, 16) + 2
    for name, block in fitted.blocks.items():
        assert rows[:, block].var(axis=0).sum() == pytest.approx(WEIGHTS[name]), name
        np.testing.assert_allclose(rows[:, block].mean(axis=0), 0.0, atol=1e-9)


def test_a_clip_has_the_same_features_in_any_set(real: SampleSet, descriptor: KinematicDescriptor) -> None:
    whole, one = descriptor.frames(real), descriptor.frames(real.select([7]))
    np.testing.assert_allclose(one[0], whole[7], rtol=1e-6, atol=1e-7)
    clips = whole.clips(np.arange(40), 24)
    np.testing.assert_allclose(descriptor.describe(clips[9:11], FPS), descriptor.describe(clips, FPS)[9:11], atol=1e-12)


def test_real_motion_follows_itself_and_what_is_smooth_or_noisy_does_not(
    real: SampleSet, descriptor: KinematicDescriptor
) -> None:
    from eval.sets.corruptions import low_pass

    rng = np.random.default_rng(3)
    slow = real.with_positions("slow", FPS, [low_pass(take[None], 120.0, 8.0)[0] for take in real.sequences])
    noisy = slow.with_positions(
        "noisy", FPS, [(take + 0.001 * rng.standard_normal(take.shape)).astype(np.float32) for take in slow.sequences]
    )
    following = {each.name: descriptor.following(gaussian(each, descriptor)) for each in (real, slow, noisy)}
    assert following["stamping"] == pytest.approx(1.0, abs=0.1)
    assert abs(following["slow"]) < 0.1
    assert abs(following["noisy"]) < 0.15
    reference = gaussian(real, descriptor)
    honest, cheat = (descriptor.score(reference, gaussian(each, descriptor)) for each in (slow, noisy))
    assert cheat > 0.8 * honest > 0.05


def test_a_score_is_zero_for_itself_and_grows_one_way(real: SampleSet, descriptor: KinematicDescriptor) -> None:
    """Fast motion that follows more closely than in real motion is not counted, less closely is."""
    rows = described(real, descriptor)
    reference = fit_gaussian(rows)
    assert descriptor.score(reference, reference) == pytest.approx(0.0, abs=1e-9)
    first = descriptor.num_distance
    less, more = rows.copy(), rows.copy()
    less[:, first] *= 0.5
    more[:, first] *= 2.0
    assert descriptor.score(reference, fit_gaussian(less)) == pytest.approx(kinematic.TIMING_WEIGHT / 4, rel=1e-6)
    assert descriptor.score(reference, fit_gaussian(more)) == pytest.approx(0.0, abs=1e-9)


def test_it_is_saved_without_pickle_and_read_back(descriptor: KinematicDescriptor, tmp_path: Path) -> None:
    path = tmp_path / "fit.npz"
    descriptor.save(path)
    again = load_kinematic(path)
    assert again.fingerprint == descriptor.fingerprint
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(DamagedFileError):
        load_kinematic(path)


def test_a_file_of_the_first_version_is_refused(real: SampleSet, tmp_path: Path) -> None:
    fit_version_1_on(real).save(tmp_path / "old.npz")
    with pytest.raises(ValueError, match="kinematic/1"):
        load_kinematic(tmp_path / "old.npz")


def test_other_framerates_and_no_motion_are_refused(real: SampleSet, descriptor: KinematicDescriptor) -> None:
    with pytest.raises(ValueError, match="fitted at 120"):
        descriptor.frames(real.with_positions("60", Fraction(60), list(real.sequences)))
    with pytest.raises(ValueError, match="at least one motion"):
        fit_kinematic([], FPS)


def test_twenty_frames_a_second_have_no_timing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(features, "FIT_CLIPS", 256)
    slow = sample_set("slow", Fraction(20), [take[::6] for take in stamping().sequences], [str(i) for i in range(12)])
    fitted = fit_on(slow)
    places = place_clips(draw_clips(Protocol(num_clips=200), Fraction(20), 0, REAL), slow)
    reference = fit_gaussian(describe_clips(readable(slow, fitted), places, fitted))
    assert np.isfinite(fitted.score(reference, reference))
    assert fitted.following(reference) == pytest.approx(0.0)
