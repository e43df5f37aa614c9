"""How far apart samples of one set are: the diversity of text-to-motion and the NeRM paper (Eq. 7)."""

import numpy as np
from jaxtyping import Float

PAIRS = 300
"""D_a of the paper."""


def diversity(
    features: Float[np.ndarray, "samples features"], rng: np.random.Generator, num_pairs: int = PAIRS
) -> float:
    """Mean distance of random pairs: two random subsets of `num_pairs` samples, each without repetition (Eq. 7).

    Closer to the real set's is better; more is not. With fewer samples each subset is a permutation of all. Raises
    `ValueError` for fewer than two samples or for features that are not finite.
    """
    if len(features) < 2:
        raise ValueError(f"{len(features)} sample has no distance to another one")
    if not np.isfinite(features).all():
        raise ValueError("features hold NaN or infinity")
    size = min(num_pairs, len(features))
    first, second = (rng.choice(len(features), size=size, replace=False) for _ in range(2))
    wide = features.astype(np.float64)
    return float(np.linalg.norm(wide[first] - wide[second], axis=1).mean())
