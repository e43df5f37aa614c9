import numpy as np
import pytest

from eval.metrics.actions import diversity

RNG = np.random.default_rng


def test_two_far_groups_are_apart_in_half_of_the_pairs() -> None:
    features = np.zeros((4000, 3))
    features[2000:, 0] = 10.0
    assert diversity(features, RNG(0), num_pairs=2000) == pytest.approx(5.0, rel=0.05)


def test_it_is_the_expected_distance_of_normal_samples_whatever_the_number_of_pairs() -> None:
    features = RNG(1).normal(size=(3000, 64))
    expected = np.mean([np.linalg.norm(features[::2] - features[1::2], axis=1).mean()])
    for pairs in (300, 1500):
        assert diversity(features, RNG(2), pairs) == pytest.approx(expected, rel=0.02)
    assert diversity(3.0 * features + 7.0, RNG(2)) == pytest.approx(3.0 * diversity(features, RNG(2)))


def test_identical_samples_have_none() -> None:
    assert diversity(np.ones((500, 4)), RNG(0)) == 0.0


def test_one_sample_and_broken_features_are_refused() -> None:
    with pytest.raises(ValueError, match="1 sample has no distance"):
        diversity(np.zeros((1, 4)), RNG(0))
    with pytest.raises(ValueError, match="NaN"):
        diversity(np.full((3, 4), np.nan), RNG(0))
