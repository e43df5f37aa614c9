"""Accuracy of an action recogniser on generated motions."""

import numpy as np
from jaxtyping import Float, Int


def accuracy(scores: Float[np.ndarray, "samples classes"], labels: Int[np.ndarray, "samples"]) -> float:
    """Share of samples whose own class has the highest score; classes that tie for it share the hit.

    So a recogniser that gives every class the same score has chance accuracy, whatever the order of classes. Raises
    `ValueError` for no samples, unequal numbers, labels outside the classes, NaN or infinity. Source: action-to-motion.
    """
    if len(scores) != len(labels) or not len(labels):
        raise ValueError(f"there are {len(scores)} rows of scores and {len(labels)} labels")
    if not np.isfinite(scores).all():
        raise ValueError("scores hold NaN or infinity")
    if labels.min() < 0 or labels.max() >= scores.shape[1]:
        raise ValueError(f"labels run from {labels.min()} to {labels.max()}, but there are {scores.shape[1]} classes")
    best = scores == scores.max(axis=1, keepdims=True)
    return float((best[np.arange(len(labels)), labels] / best.sum(axis=1)).mean())
