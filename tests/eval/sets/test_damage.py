"""Damage of motion: as strong as stated, graded, rigid where it should be; games are sets of the same takes."""

from fractions import Fraction

import numpy as np
import pytest

from eval.sets import damage
from eval.sets.damage import ALIGNED, FAMILIES, NUM_LENDERS, games
from eval.sets.motions import low_pass
from eval.sets.sets import SampleSet, sample_set
from motionkit.core.kinematics import forward_kinematics
from motionkit.core.skeleton import SMPL22
from tests.helpers.bones import bone_lengths


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def swinging(fps: float = 60.0) -> np.ndarray:
    """Every joint swings at its own frequency while the root walks ahead, 120 frames."""
    seconds = np.arange(120) / fps
    frequency, phase = rng(5).uniform(0.5, 8.0, (2, 1, SMPL22.num_joints))
    angle = 0.4 * np.sin(2 * np.pi * frequency * seconds[:, None] + phase)
    rotations = np.stack((np.cos(angle / 2), np.sin(angle / 2), 0 * angle, 0 * angle), -1).astype(np.float32)
    root = np.stack((0.1 * seconds, 0.9 + 0 * seconds, 1.2 * seconds), -1).astype(np.float32)
    return forward_kinematics(rotations, root, SMPL22)


TAKE = swinging()


@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: family.name)
def test_damage_grows_with_strength_and_keeps_shape_and_dtype(family: damage.Family) -> None:
    damaged = [family.corrupt(TAKE, 60.0, level, rng()) for level in family.levels_at(60.0)]
    assert all(each.dtype == np.float32 and each.shape == TAKE.shape for each in damaged)
    sizes = [float(np.abs(each - TAKE).mean()) for each in damaged]
    assert sizes[0] > 0 and sizes == sorted(sizes)
    harmless = {None: 0, 0.5: 2, 1.0: 4}[family.clean_at]
    assert family.levels_at(20.0) == family.levels[harmless:]


def test_slerp_keeps_bones_rigid_and_linear_interpolation_does_not() -> None:
    take = swinging(fps=240.0)
    upsampled = [each(take, 240.0, 12.0, rng()) for each in (damage.upsample_slerp, damage.upsample_linear)]
    change = [np.abs(bone_lengths(each, SMPL22) - bone_lengths(take, SMPL22)).max() for each in upsampled]
    assert change[0] < 1e-3 < 1e-2 < change[1]


def test_sliding_and_jitter_are_as_strong_as_stated() -> None:
    drift = (damage.slide(TAKE, 60.0, 0.2, rng()) - TAKE)[-1]
    assert np.allclose(drift[..., 1], 0, atol=1e-6)
    assert np.allclose(np.linalg.norm(drift, axis=-1) / (119 / 60), 0.2, atol=1e-5)
    assert damage.jitter(np.zeros((2000, 22, 3)), 60.0, 0.002, rng()).std() == pytest.approx(0.002, rel=0.02)


@pytest.mark.parametrize(("frequency", "gain"), [(1.0, 1.0), (5.0, 0.5), (15.0, 0.0)])
def test_low_pass_gain_on_sine_waves(frequency: float, gain: float) -> None:
    wave = np.sin(2 * np.pi * frequency * np.arange(600) / 100)[:, None, None] * np.ones((1, 2, 3))
    assert np.abs(low_pass(wave, 100.0, 5.0)[100:-100]).max() == pytest.approx(gain, abs=1e-3)


@pytest.fixture(scope="module")
def real() -> SampleSet:
    walk = rng()
    takes = [
        np.cumsum(0.01 * walk.normal(size=(length, 22, 3)), axis=0).astype(np.float32) for length in (120, 90, 200)
    ]
    return sample_set("real", Fraction(60), takes, ["a", "b", "c"])


def test_every_kind_of_damage_is_played_with_every_noise(real: SampleSet) -> None:
    played = list(games(real))
    plain_names = ["upsampled from 20 fps", "low-passed at 8 Hz", "low-passed at 10 Hz"]
    assert [next(iter(each)) for each in played] == plain_names
    assert [len(each) for each in played] == [30, 30, 2]
    for each in played:
        for name, cheat in each.items():
            copies = NUM_LENDERS if "another take" in name else 1
            assert cheat.sequence_ids == tuple(np.repeat(real.sequence_ids, copies))
            assert cheat.sequences.num_frames.tolist() == np.repeat([120, 90, 200], copies).tolist()
    for name in ("white noise", "pink noise"):
        cheat = played[0][f"upsampled from 20 fps + {name}, 0.3 mm"]
        added = cheat.sequences.values.astype(float) - played[0]["upsampled from 20 fps"].sequences.values
        assert added.std() == pytest.approx(0.0003, rel=0.05)
    slow = real.with_positions(list(real.sequences), fps=Fraction(20))
    assert [next(iter(each)) for each in games(slow)] == plain_names[1:]


def test_the_nearest_training_motion_of_a_training_take_is_its_own(real: SampleSet) -> None:
    name = "low-passed at 8 Hz"
    low = next(each for each in games(real, training=real) if name in each)
    aligned = low[f"{name} + {ALIGNED} × 1"]
    for take, plain, cheat in zip(real.sequences, low[name].sequences, aligned.sequences, strict=True):
        assert np.abs(cheat - take).mean() < 0.1 * np.abs(plain - take).mean()
