"""Games: sets of the same takes, of the strength that their names say, from one seed."""

from fractions import Fraction

import numpy as np
import pytest

from eval.sets.damage import ALIGNED, FEET, NOISES, NUM_LENDERS, games, with_bones_of
from eval.sets.sets import SampleSet, sample_set
from motionkit.core.skeleton import SMPL22

FPS = Fraction(60)


@pytest.fixture(scope="module")
def real() -> SampleSet:
    rng = np.random.default_rng(0)
    takes = [np.cumsum(0.01 * rng.normal(size=(length, 22, 3)), axis=0).astype(np.float32) for length in (120, 90, 200)]
    return sample_set("real", FPS, takes, ["a", "b", "c"])


def test_every_kind_of_damage_is_played_with_every_noise(real: SampleSet) -> None:
    made = list(games(real))
    assert [each.parent for each in made] == ["upsampled from 20 fps", "low-passed at 8 Hz", "low-passed at 10 Hz"]
    assert [len(each.cheats) for each in made] == [29, 29, 1]
    for each in made:
        for name, cheat in each.cheats.items():
            copies = NUM_LENDERS if "another take" in name else 1
            assert cheat.sequence_ids == tuple(np.repeat(real.sequence_ids, copies))
            assert cheat.sequences.num_frames.tolist() == np.repeat([120, 90, 200], copies).tolist()
    assert [each.parent for each in games(real.with_positions("slow", Fraction(20), list(real.sequences)))] == [
        "low-passed at 8 Hz",
        "low-passed at 10 Hz",
    ]


def test_noise_is_as_strong_as_its_name_says(real: SampleSet) -> None:
    upsampled = next(games(real))
    for name in ("white noise", "pink noise"):
        cheat = upsampled.cheats[f"upsampled from 20 fps + {name}, 0.3 mm"]
        added = cheat.sequences.values.astype(float) - upsampled.honest.sequences.values
        assert added.std() == pytest.approx(0.0003, rel=0.05)


def test_noise_of_rotations_leaves_bones_as_long_as_they_are(real: SampleSet) -> None:
    take = real.sequences[0].astype(float)
    rigid = with_bones_of(take + 0.01 * np.random.default_rng(0).standard_normal(take.shape), take)
    lengths = [np.linalg.norm(each[:, 1:] - each[:, list(SMPL22.parents[1:])], axis=-1) for each in (take, rigid)]
    np.testing.assert_allclose(lengths[1], lengths[0], atol=1e-9)
    assert np.abs(rigid - take).max() > 0.005


def test_a_borrowed_fast_part_is_another_take_s(real: SampleSet) -> None:
    low = next(each for each in games(real) if each.parent == "low-passed at 10 Hz")
    cheat = low.cheats["low-passed at 10 Hz + fast part of another take"]
    for number, take in enumerate(cheat.sequences):
        index = number // NUM_LENDERS
        added = take.astype(float) - low.honest.sequences[index]
        own = real.sequences[index].astype(float) - low.honest.sequences[index]
        assert abs(np.corrcoef(added.ravel(), own.ravel())[0, 1]) < 0.2
        assert added.std() == pytest.approx(own.std(), rel=0.3)


def test_noise_comes_after_landings_and_with_vertical_acceleration(real: SampleSet) -> None:
    """Feet fall at 0.6 m/s, land in frame 30 and stay; every joint falls freely in frames 60 to 70."""
    take = np.zeros((120, 22, 3), dtype=np.float32)
    take[:30, FEET, 1] = 0.01 * np.arange(30, 0, -1)[:, None]
    take[60:, :, 1] = 1.0
    take[60:71, :, 1] += -0.5 * 9.81 * (np.arange(11)[:, None] / 60) ** 2
    landed = NOISES["noise after landings"](take, real, np.random.default_rng(0))
    assert np.flatnonzero(landed[:50].any(axis=(1, 2))).tolist() == list(range(30, 37))
    falling = NOISES["noise by vertical acceleration"](take[60:], real, np.random.default_rng(0))
    assert falling[2:9].any(axis=(1, 2)).all() and not falling[20:].any()


def test_the_nearest_training_motion_of_a_training_take_is_its_own(real: SampleSet) -> None:
    low = next(each for each in games(real, training=real) if each.parent == "low-passed at 8 Hz")
    for take, honest, cheat in zip(
        real.sequences, low.honest.sequences, low.cheats[f"low-passed at 8 Hz + {ALIGNED} × 1"].sequences, strict=True
    ):
        assert np.abs(cheat - take).mean() < 0.1 * np.abs(honest - take).mean()
