"""Mean and standard deviation of rows: streamed, merged, exact to float64 whatever the offset."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from motionkit.core.shapes import Float, Float64


@dataclass(frozen=True, eq=False)
class Moments:
    """Count, mean and sum of squared deviations of rows, float64: enough to merge and to finish."""

    count: int
    mean: Float64[np.ndarray, "numbers"]
    squared_deviations: Float64[np.ndarray, "numbers"]

    @property
    def std(self) -> Float64[np.ndarray, "numbers"]:
        """Standard deviation over all rows (ddof 0)."""
        return np.sqrt(self.squared_deviations / self.count)


def moments(rows: Float[np.ndarray, "rows numbers"]) -> Moments:
    """Moments of rows; raises `ValueError` for no rows or non-finite numbers."""
    values = rows.astype(np.float64)
    if len(values) == 0 or not np.isfinite(values).all():
        raise ValueError(f"statistics need at least one row of finite numbers; these {rows.shape} are not")
    mean = values.mean(axis=0)
    return Moments(len(values), mean, np.square(values - mean).sum(axis=0))


def merge(a: Moments, b: Moments) -> Moments:
    """Moments of all rows of both (Chan, Golub & LeVeque 1979)."""
    count = a.count + b.count
    difference = b.mean - a.mean
    deviations = a.squared_deviations + b.squared_deviations + difference**2 * (a.count * b.count / count)
    return Moments(count, a.mean + difference * (b.count / count), deviations)


def stream(parts: Iterable[npt.NDArray[np.floating]]) -> Moments:
    """Moments of many parts [rows, numbers], one at a time in memory; raises `ValueError` without parts."""
    total: Moments | None = None
    for part in parts:
        own = moments(part)
        total = own if total is None else merge(total, own)
    if total is None:
        raise ValueError("statistics need at least one part")
    return total
