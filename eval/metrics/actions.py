"""Metrics of the action task: accuracy, diversity, multimodality."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from eval.metrics.checks import checked_features
from eval.metrics.metric import Arguments, Metric, by_frames
from motionkit.core.shapes import Float, Float64, Int, Int64


def accuracy(scores: Float[np.ndarray, "samples classes"], labels: Int[np.ndarray, "samples"]) -> float:
    """Share of samples whose own class has the highest score; classes that tie for it share the hit.

    Equal scores for all classes thus have chance accuracy, in any order of classes. Raises `ValueError` for no samples,
    unequal numbers, labels outside the classes, NaN or infinity. Source: action-to-motion.
    """
    return float(shares_of_hits(scores, labels).mean())


def shares_of_hits(
    scores: Float[np.ndarray, "samples classes"], labels: Int[np.ndarray, "samples"]
) -> Float64[np.ndarray, "samples"]:
    """1 if a sample's own class has the highest score, a fraction for ties; raises as `accuracy`."""
    if len(scores) != len(labels) or not len(labels):
        raise ValueError(f"there are {len(scores)} rows of scores and {len(labels)} labels")
    if not np.isfinite(scores).all():
        raise ValueError("scores hold NaN or infinity")
    if labels.min() < 0 or labels.max() >= scores.shape[1]:
        raise ValueError(f"labels run from {labels.min()} to {labels.max()}, but there are {scores.shape[1]} classes")
    best = scores == scores.max(axis=1, keepdims=True)
    return np.asarray(best[np.arange(len(labels)), labels] / best.sum(axis=1))


NUM_PAIRS = 10

CLASS_PAIRS = 20
"""Pairs of every class in the action protocols."""


def multimodality(
    features: Float[np.ndarray, "texts generations features"], *, rng: np.random.Generator, num_pairs: int = NUM_PAIRS
) -> float:
    """Mean distance of pairs of motions of the same text; pairs are drawn per text, and no motion is in two of them.

    NeRM Eq. 8: two distinct random subsets of `num_pairs` motions of every text. Raises `ValueError` if a text has
    fewer than 2 · `num_pairs` generations, for NaN or infinity.
    """
    values = _checked(features)
    texts, generations, _ = values.shape
    if num_pairs < 1 or generations < 2 * num_pairs:
        raise ValueError(
            f"MultiModality of {num_pairs} distinct pairs needs at least {max(2, 2 * num_pairs)} generations of each "
            f"text, there are {generations}"
        )
    order = rng.permuted(np.tile(np.arange(generations), (texts, 1)), axis=1)[..., None]
    first = np.take_along_axis(values, order[:, :num_pairs], axis=1)
    second = np.take_along_axis(values, order[:, num_pairs : 2 * num_pairs], axis=1)
    return float(np.linalg.norm(first - second, axis=-1).mean())


def multimodality_shared_pairs(
    features: Float[np.ndarray, "texts generations features"], *, rng: np.random.Generator, num_pairs: int = NUM_PAIRS
) -> float:
    """Mean distance of pairs of motions of one text, with the same index pairs for all texts, as the reference code.

    Each side is drawn without replacement, independently: a motion may be paired with itself (distance 0), which makes
    this smaller than `multimodality` by the factor 1 − 1/generations in expectation. Source: text-to-motion,
    metrics.calculate_multimodality (100 texts × 30 generations, 10 pairs).
    """
    values = _checked(features)
    generations = values.shape[1]
    if not 1 <= num_pairs <= generations:
        raise ValueError(f"{num_pairs} pairs need at least {num_pairs} generations of each text, not {generations}")
    first, second = (rng.permutation(generations)[:num_pairs] for _ in range(2))
    return float(np.linalg.norm(values[:, first] - values[:, second], axis=-1).mean())


def multimodality_by_class(
    features: Float[np.ndarray, "samples features"],
    labels: Int[np.ndarray, "labels"],
    *,
    rng: np.random.Generator,
    num_pairs: int = CLASS_PAIRS,
) -> float:
    """Mean distance of random pairs of two different motions of one class, with equally many pairs per class.

    Raises `ValueError` for a class with a single motion, NaN or infinity. Defined here; the action protocols may pair a
    motion with itself (`multimodality_by_class_with_replacement`).
    """

    def draw(members: int) -> tuple[Int64[np.ndarray, "pairs"], Int64[np.ndarray, "pairs"]]:
        first = rng.integers(members, size=num_pairs)
        # An offset of 1 … members − 1, modulo members, never pairs a motion with itself.
        return first, (first + rng.integers(1, members, size=num_pairs)) % members

    return _by_class(features, labels, draw, least=2)


def multimodality_by_class_with_replacement(
    features: Float[np.ndarray, "samples features"],
    labels: Int[np.ndarray, "labels"],
    *,
    rng: np.random.Generator,
    num_pairs: int = CLASS_PAIRS,
) -> float:
    """Mean distance of random pairs of one class, both sides drawn with replacement, with equally many pairs per class.

    A motion may be paired with itself. The reference draws pairs from the whole set until every class has its share,
    which is the same distribution. Raises `ValueError` for NaN or infinity. Source: action-to-motion.
    """

    def draw(members: int) -> tuple[Int64[np.ndarray, "pairs"], Int64[np.ndarray, "pairs"]]:
        return rng.integers(members, size=num_pairs), rng.integers(members, size=num_pairs)

    return _by_class(features, labels, draw, least=1)


def _by_class(
    features: Float[np.ndarray, "samples features"],
    labels: Int[np.ndarray, "labels"],
    draw: Callable[[int], tuple[Int64[np.ndarray, "pairs"], Int64[np.ndarray, "pairs"]]],
    *,
    least: int,
) -> float:
    values = checked_features(features, "features", minimum=1)
    if labels.shape != (len(values),):
        raise ValueError(f"there are {len(values)} motions and {len(labels)} labels")
    means = []
    for label in np.unique(labels).tolist():
        members = values[labels == label]
        if len(members) < least:
            raise ValueError(f"class {label} has a single motion: it has no distance to another one of its class")
        first, second = draw(len(members))
        means.append(np.linalg.norm(members[first] - members[second], axis=1).mean())
    return float(np.mean(means))


def _checked(
    features: Float[np.ndarray, "texts generations features"],
) -> Float64[np.ndarray, "texts generations features"]:
    values = np.asarray(features, dtype=np.float64)
    if not len(values):
        raise ValueError("there are no texts to measure MultiModality on")
    finite = np.isfinite(values).all(axis=(1, 2))
    if not finite.all():
        raise ValueError(
            f"{int((~finite).sum())} of {len(values)} texts have NaN or infinite features, the first is text "
            f"{int(np.argmin(finite))}"
        )
    return values


PAIRS = 300
"""D_a of the paper."""

ACTION_PAIRS = 200
"""Pairs of the action protocols."""


def diversity(
    features: Float[np.ndarray, "samples features"], rng: np.random.Generator, num_pairs: int = PAIRS
) -> float:
    """Mean distance of random pairs: two random subsets of `num_pairs` samples, each without repetition (Eq. 7).

    Closer to the real set's is better; more is not. With fewer samples each subset is a permutation of all. Raises
    `ValueError` for fewer than two samples or for features that are not finite.
    """
    _check(features)
    size = min(num_pairs, len(features))
    first, second = (rng.choice(len(features), size=size, replace=False) for _ in range(2))
    return _mean_distance(features, first, second)


def diversity_with_replacement(
    features: Float[np.ndarray, "samples features"], rng: np.random.Generator, num_pairs: int = ACTION_PAIRS
) -> float:
    """Mean distance of random pairs, both sides drawn with replacement, as the action protocols do.

    Raises `ValueError` for fewer than two samples or features that are not finite. Source: action-to-motion.
    """
    _check(features)
    return _mean_distance(features, *(rng.integers(len(features), size=num_pairs) for _ in range(2)))


def _check(features: Float[np.ndarray, "samples features"]) -> None:
    if len(features) < 2:
        raise ValueError(f"{len(features)} sample has no distance to another one")
    if not np.isfinite(features).all():
        raise ValueError("features hold NaN or infinity")


def _mean_distance(
    features: Float[np.ndarray, "samples features"], first: npt.NDArray[np.int64], second: npt.NDArray[np.int64]
) -> float:
    differences = features[first].astype(np.float64) - features[second]
    return float(np.linalg.norm(differences, axis=1).mean())


_SCORES: Arguments = "scores, labels"
_ONE: Arguments = "one set"
METRICS = (
    Metric("accuracy", "Accuracy", "", True, "action-to-motion (Guo et al. 2020)", _SCORES, accuracy, by_frames),
    Metric("multimodality", "MultiModality", "", None, "NeRM Eq. 8", _ONE, multimodality, by_frames),
    Metric(
        "multimodality_shared_pairs",
        "MultiModality (shared pairs)",
        "",
        None,
        "text-to-motion (Guo et al. 2022)",
        _ONE,
        multimodality_shared_pairs,
    ),
    Metric(
        "multimodality_by_class",
        "MultiModality (by action)",
        "",
        None,
        "motionkit: pairs of two different motions",
        _ONE,
        multimodality_by_class,
    ),
    Metric(
        "multimodality_by_class_with_replacement",
        "MultiModality (by action, with replacement)",
        "",
        None,
        "action-to-motion (Guo et al. 2020)",
        _ONE,
        multimodality_by_class_with_replacement,
    ),
    Metric("diversity", "Diversity", "", None, "text-to-motion; NeRM Eq. 7", _ONE, diversity),
    Metric(
        "diversity_with_replacement",
        "Diversity (with replacement)",
        "",
        None,
        "action-to-motion (Guo et al. 2020)",
        _ONE,
        diversity_with_replacement,
    ),
)
