"""How far apart samples of one set are: the diversity of text-to-motion and the NeRM paper (Eq. 7)."""

import numpy as np
import numpy.typing as npt
from jaxtyping import Float

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
