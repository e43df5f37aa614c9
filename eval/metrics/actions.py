"""Accuracy of action recognition; Diversity and MultiModality: mean distances of random pairs of features."""

from functools import partial

import numpy as np

from eval.metrics.distributions import checked_features
from eval.metrics.metric import Metric, by_frames
from motionkit.core.shapes import Float, Float64, Int

NUM_PAIRS = 10
PAIRS = 300
"""D_a of the NeRM paper; the action protocols draw 200."""
Features = Float[np.ndarray, "samples features"]
Repeated = Float[np.ndarray, "texts generations features"]
Scores = Float[np.ndarray, "samples classes"]
Labels = Int[np.ndarray, "samples"]


def accuracy(scores: Scores, labels: Labels) -> float:
    """Share of samples whose own class has the highest score; classes that tie for it share the hit.

    Equal scores for all classes thus have chance accuracy, in any order of classes. Raises `ValueError` for no samples,
    unequal numbers, labels outside the classes, NaN or infinity. Source: action-to-motion.
    """
    return float(shares_of_hits(scores, labels).mean())


def shares_of_hits(scores: Scores, labels: Labels) -> Float64[np.ndarray, "samples"]:
    """1 if a sample's own class has the highest score, a fraction for ties; raises as `accuracy`."""
    checked_features(scores, "scores", minimum=1)
    if labels.min() < 0 or labels.max() >= scores.shape[1]:
        raise ValueError(f"labels run from {labels.min()} to {labels.max()}, but there are {scores.shape[1]} classes")
    best = scores == scores.max(axis=1, keepdims=True)
    return np.asarray(best[np.arange(len(labels)), labels] / best.sum(axis=1))


def diversity(features: Features, rng: np.random.Generator, num_pairs: int = PAIRS, *, replace: bool = False) -> float:
    """Mean distance of random pairs: two random subsets of `num_pairs` samples, each without repetition (NeRM Eq. 7).

    Closer to the real set's is better; more is not. With fewer samples each subset is a permutation of all. With
    `replace`, as in action-to-motion, both sides are drawn with replacement. Raises `ValueError` for fewer than two
    samples or for features that are not finite.
    """
    values = checked_features(features, "features", minimum=2)
    size = num_pairs if replace else min(num_pairs, len(values))
    first, second = (rng.choice(len(values), size=size, replace=replace) for _ in range(2))
    return float(np.linalg.norm(values[first] - values[second], axis=1).mean())


def multimodality(features: Repeated, *, rng: np.random.Generator, num_pairs: int = NUM_PAIRS) -> float:
    """Mean distance of pairs of motions of the same text; pairs are drawn per text, and no motion is in two of them.

    NeRM Eq. 8: two distinct random subsets of `num_pairs` motions of every text. Raises `ValueError` if a text has
    fewer than 2 · `num_pairs` generations, for NaN or infinity.
    """
    values = _checked_texts(features, least=2 * num_pairs)
    texts, generations, _ = values.shape
    order = rng.permuted(np.tile(np.arange(generations), (texts, 1)), axis=1)[..., None]
    first = np.take_along_axis(values, order[:, :num_pairs], axis=1)
    second = np.take_along_axis(values, order[:, num_pairs : 2 * num_pairs], axis=1)
    return float(np.linalg.norm(first - second, axis=-1).mean())


def multimodality_shared_pairs(features: Repeated, *, rng: np.random.Generator, num_pairs: int = NUM_PAIRS) -> float:
    """Mean distance of pairs of motions of one text, with the same index pairs for all texts, as the reference code.

    Each side is drawn without replacement, independently: a motion may be paired with itself (distance 0), which makes
    this smaller than `multimodality` by the factor 1 − 1/generations in expectation. Source: text-to-motion,
    metrics.calculate_multimodality (100 texts × 30 generations, 10 pairs).
    """
    values = _checked_texts(features, least=num_pairs)
    first, second = (rng.permutation(values.shape[1])[:num_pairs] for _ in range(2))
    return float(np.linalg.norm(values[:, first] - values[:, second], axis=-1).mean())


def _checked_texts(features: Repeated, least: int) -> Float64[np.ndarray, "texts generations features"]:
    if features.shape[1] < least:
        raise ValueError(
            f"MultiModality needs at least {least} generations of each text, there are {features.shape[1]}"
        )
    rows = features.reshape(-1, features.shape[2])
    return checked_features(rows, "features", minimum=1).reshape(features.shape)


def multimodality_by_class(
    features: Features, labels: Labels, *, rng: np.random.Generator, num_pairs: int = 20, replace: bool = False
) -> float:
    """Mean distance of random pairs of two different motions of one class, with equally many pairs per class.

    With `replace` both sides are drawn with replacement, so a motion may be paired with itself. Action-to-motion draws
    pairs from the whole set until every class has its share, which is the same distribution. Raises `ValueError` for
    NaN, infinity, and without `replace` for a class with a single motion.
    """
    values = checked_features(features, "features", minimum=1)
    means = []
    for label in np.unique(labels).tolist():
        members = values[labels == label]
        if len(members) < 2 and not replace:
            raise ValueError(f"class {label} has a single motion: it has no distance to another one of its class")
        first = rng.integers(len(members), size=num_pairs)
        if replace:
            second = rng.integers(len(members), size=num_pairs)
        else:
            # An offset of 1 … members − 1, modulo members, never pairs a motion with itself.
            second = (first + rng.integers(1, len(members), size=num_pairs)) % len(members)
        means.append(np.linalg.norm(members[first] - members[second], axis=1).mean())
    return float(np.mean(means))


_T2M, _A2M = "text-to-motion (Guo et al. 2022)", "action-to-motion (Guo et al. 2020)"
_OURS, _BY_ACTION = "motionkit: pairs of two different motions", "MultiModality (by action"
_REPLACED, _ALL_REPLACED = (partial(function, replace=True) for function in (multimodality_by_class, diversity))
METRICS = (
    Metric("accuracy", "Accuracy", "", True, _A2M, accuracy, by_frames),
    Metric("diversity", "Diversity", "", None, "text-to-motion; NeRM Eq. 7", diversity),
    Metric("diversity_with_replacement", "Diversity (with replacement)", "", None, _A2M, _ALL_REPLACED),
    Metric("multimodality", "MultiModality", "", None, "NeRM Eq. 8", multimodality, by_frames),
    Metric("multimodality_shared_pairs", "MultiModality (shared pairs)", "", None, _T2M, multimodality_shared_pairs),
    Metric("multimodality_by_class", f"{_BY_ACTION})", "", None, _OURS, multimodality_by_class),
    Metric("multimodality_by_class_with_replacement", f"{_BY_ACTION}, with replacement)", "", None, _A2M, _REPLACED),
)
