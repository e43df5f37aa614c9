"""Means over replications and their 95 % intervals."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Estimate:
    """A mean over replications; `ci95` is half the width of its 95 % interval, 0 for a single replication."""

    mean: float
    ci95: float
    replications: int

    def __str__(self) -> str:
        return f"{self.mean:.4g} ± {self.ci95:.2g}"


def estimate(values: Sequence[float]) -> Estimate:
    """Mean ± 1.96·std(ddof 0)/√R over R replications (text-to-motion final_evaluations.py)."""
    if not len(values):
        raise ValueError("there are no replications to average")
    array = np.asarray(values, dtype=np.float64)
    if not np.isfinite(array).all():
        raise ValueError(f"a replication is not finite: {array.tolist()}")
    return Estimate(float(array.mean()), float(1.96 * array.std() / np.sqrt(array.size)), array.size)


def variance_spread(values: Sequence[float]) -> float:
    """1.96 · variance (ddof 0) over replications: what ACTOR prints after "±". It is no interval of anything."""
    return float(1.96 * np.var(np.asarray(values, dtype=np.float64)))
