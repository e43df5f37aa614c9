"""Diversity, MultiModality, accuracy: the definitions straight from their words, known answers, refusals."""

import numpy as np
import pytest

from eval.metrics.actions import accuracy, diversity, multimodality, multimodality_by_class, multimodality_shared_pairs

RNG = np.random.default_rng(0)


def all_pairs(features: np.ndarray) -> float:
    """The sum of the distances of all ordered pairs."""
    return float(np.linalg.norm(features[:, None] - features[None], axis=-1).sum())


def test_diversity_tends_to_the_mean_distance_of_all_pairs() -> None:
    features = RNG.normal(size=(50, 3))
    rng = np.random.default_rng(7)
    first, second = rng.choice(50, size=30, replace=False), rng.choice(50, size=30, replace=False)
    drawn = np.linalg.norm(features[first] - features[second], axis=1).mean()
    assert diversity(features, rng=np.random.default_rng(7), num_pairs=30) == pytest.approx(drawn)
    # Both count a sample's distance to itself with probability 1/N: the mean over the whole matrix, diagonal included.
    expected = all_pairs(features) / 50**2
    assert np.mean([diversity(features, RNG, 50) for _ in range(400)]) == pytest.approx(expected, rel=0.01)
    assert diversity(features, RNG, 20000, replace=True) == pytest.approx(expected, rel=0.03)


def test_multimodality_never_pairs_a_motion_with_itself_and_the_shared_pairs_do() -> None:
    generations = np.tile(np.arange(20.0)[None, :, None], (300, 1, 1))
    expected = all_pairs(generations[0]) / (20 * 19)
    assert multimodality(generations, rng=RNG, num_pairs=10) == pytest.approx(expected, rel=0.05)
    shared = np.mean([multimodality_shared_pairs(generations[:1], rng=RNG, num_pairs=10) for _ in range(2000)])
    assert shared == pytest.approx(expected * (1 - 1 / 20), rel=0.03)
    assert multimodality(generations[:, :2], rng=RNG, num_pairs=1) == 1.0


def test_pairs_of_a_class_have_the_distribution_of_the_reference() -> None:
    labels = np.arange(24) % 4
    features = RNG.normal(size=(24, 3)) + labels[:, None]
    # Action-to-motion draws pairs from the whole set until every class has its share: here 2,000 pairs of each.
    left, total = np.full(4, 2000), 0.0
    while left.any():
        first, second = RNG.integers(24, size=2)
        if labels[first] == labels[second] and left[labels[first]]:
            left[labels[first]] -= 1
            total += float(np.linalg.norm(features[first] - features[second]))
    replaced = multimodality_by_class(features, labels, rng=RNG, num_pairs=3000, replace=True)
    assert replaced == pytest.approx(total / 8000, rel=0.03)
    exact = np.mean([all_pairs(features[labels == label]) / (6 * 5) for label in range(4)])
    assert multimodality_by_class(features, labels, rng=RNG, num_pairs=3000) == pytest.approx(exact, rel=0.03)
    with pytest.raises(ValueError, match="class 9 has a single motion"):
        multimodality_by_class(features, np.where(np.arange(24) == 5, 9, labels), rng=RNG)


def test_accuracy_is_the_share_of_hits_and_ties_share_theirs() -> None:
    scores = np.array([[0.9, 0.1, 0.0], [0.2, 0.3, 0.5], [0.4, 0.4, 0.2], [0.1, 0.0, 0.9]])
    assert accuracy(scores, np.array([0, 2, 1, 0])) == pytest.approx((1 + 1 + 0.5 + 0) / 4)
    assert accuracy(np.zeros((50, 4)), np.arange(50) % 4) == pytest.approx(0.25)
    scores, labels = RNG.normal(size=(200, 12)), RNG.integers(12, size=200)
    assert accuracy(scores, labels) == pytest.approx(np.mean(scores.argmax(axis=1) == labels))


def test_refusals() -> None:
    broken = np.zeros((300, 20, 2))
    broken[5, 1] = np.nan
    for call in (
        lambda: diversity(broken[:, 1], RNG, replace=True),
        lambda: multimodality(broken, rng=RNG),
        lambda: accuracy(broken[:, 1], np.zeros(300, dtype=int)),
    ):
        with pytest.raises(ValueError, match="NaN"):
            call()
    for function, needed in ((multimodality, 20), (multimodality_shared_pairs, 10)):
        with pytest.raises(ValueError, match=f"at least {needed} generations"):
            function(np.zeros((3, needed - 1, 2)), rng=RNG)
    with pytest.raises(ValueError, match="from 0 to 3, but there are 3 classes"):
        accuracy(np.zeros((2, 3)), np.array([0, 3]))
