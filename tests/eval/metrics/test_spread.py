"""Diversity, MultiModality, accuracy: the definitions straight from their words, known answers, refusals."""

import numpy as np
import pytest

from eval.metrics.actions import (
    accuracy,
    diversity,
    diversity_with_replacement,
    multimodality,
    multimodality_shared_pairs,
)


def test_diversity_of_all_samples_is_the_pairs_that_the_generator_draws() -> None:
    features = np.random.default_rng(0).normal(size=(40, 5)).astype(np.float32)
    rng = np.random.default_rng(7)
    first, second = rng.choice(40, size=30, replace=False), rng.choice(40, size=30, replace=False)
    assert len(set(first)) == len(set(second)) == 30
    pairs = zip(first, second, strict=True)
    expected = np.mean([float(np.sqrt(((features[a] - features[b]).astype(float) ** 2).sum())) for a, b in pairs])
    assert diversity(features, rng=np.random.default_rng(7), num_pairs=30) == pytest.approx(expected, rel=1e-6)


def test_diversity_tends_to_the_mean_distance_of_all_pairs() -> None:
    features = np.random.default_rng(1).normal(size=(50, 3))
    distances = np.linalg.norm(features[:, None] - features[None], axis=-1)
    rng = np.random.default_rng(0)
    without = np.mean([diversity(features, rng=rng, num_pairs=50) for _ in range(400)])
    # Both count a sample's distance to itself with probability 1/N: the mean over the whole matrix, diagonal included.
    assert without == pytest.approx(distances.mean(), rel=0.01)
    assert diversity_with_replacement(features, rng=rng, num_pairs=20000) == pytest.approx(distances.mean(), rel=0.03)


def test_multimodality_never_pairs_a_motion_with_itself_and_the_shared_pairs_do() -> None:
    # Every text's generations are 0 and 1 apart from each other in one number: distinct motions are at least 1 apart.
    generations = np.tile(np.arange(20.0)[None, :, None], (300, 1, 1))
    rng = np.random.default_rng(0)
    distinct = multimodality(generations, rng=rng, num_pairs=10)
    all_pairs = np.abs(np.arange(20)[:, None] - np.arange(20)).sum() / (20 * 19)
    assert distinct == pytest.approx(all_pairs, rel=0.05)
    shared = np.mean([multimodality_shared_pairs(generations[:1], rng=rng, num_pairs=10) for _ in range(2000)])
    assert shared == pytest.approx(all_pairs * (1 - 1 / 20), rel=0.03)
    assert multimodality(generations[:, :2], rng=rng, num_pairs=1) == 1.0


def test_accuracy_is_the_share_of_hits_and_ties_share_theirs() -> None:
    scores = np.array([[0.9, 0.1, 0.0], [0.2, 0.3, 0.5], [0.4, 0.4, 0.2], [0.1, 0.0, 0.9]])
    assert accuracy(scores, np.array([0, 2, 1, 0])) == pytest.approx((1 + 1 + 0.5 + 0) / 4)
    assert accuracy(np.zeros((50, 4)), np.arange(50) % 4) == pytest.approx(0.25)
    rng = np.random.default_rng(0)
    scores, labels = rng.normal(size=(200, 12)), rng.integers(12, size=200)
    assert accuracy(scores, labels) == pytest.approx(np.mean(scores.argmax(axis=1) == labels))


def test_refusals() -> None:
    rng = np.random.default_rng(0)
    broken = np.zeros((300, 20, 2))
    broken[5, 1] = np.nan
    with pytest.raises(ValueError, match="NaN"):
        diversity_with_replacement(broken[:, 1], rng=rng)
    with pytest.raises(ValueError, match="the first is text 5"):
        multimodality(broken, rng=rng)
    with pytest.raises(ValueError, match="at least 20 generations of each text, there are 19"):
        multimodality(np.zeros((3, 19, 2)), rng=rng)
    with pytest.raises(ValueError, match="10 pairs need"):
        multimodality_shared_pairs(np.zeros((3, 9, 2)), rng=rng)
    with pytest.raises(ValueError, match="from 0 to 3, but there are 3 classes"):
        accuracy(np.zeros((2, 3)), np.array([0, 3]))
    with pytest.raises(ValueError, match="NaN"):
        accuracy(np.full((2, 3), np.nan), np.array([0, 1]))
