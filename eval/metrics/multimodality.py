"""MultiModality: how far apart motions of the same text (or action) are."""

import numpy as np
from jaxtyping import Float, Float64

NUM_PAIRS = 10


def multimodality(
    features: Float[np.ndarray, "texts generations features"], *, rng: np.random.Generator, num_pairs: int = NUM_PAIRS
) -> float:
    """Mean distance of pairs of motions of one text; each text has its own pairs, and no motion is in two of them.

    NeRM Eq. 8: two distinct random subsets of `num_pairs` motions of every text. Raises `ValueError` where a text has
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
    """Mean distance of pairs of motions of one text, all texts with the same index pairs, as the reference code does.

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
