"""Metadata of metrics: unit, direction, source and, for means, the weights."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.generic]


@dataclass(frozen=True)
class Metric:
    """A metric as tables name it.

    `higher_is_better` is None if the best value is the real set's own. `source` is the paper, or the code, that defines
    it; `calibration` says how its robustness to gaming was tested, and where that is documented. `weight` gives the
    weight of a batch from the function's arrays; it is None if the metric is not a mean: then its function needs all
    samples. `exponent` is 2 where the metric is the root of a mean of squares. `version` is incremented when the
    meaning of its values changes.
    """

    name: str
    title: str
    unit: str
    higher_is_better: bool | None
    source: str
    function: Callable[..., object] = field(repr=False)
    weight: Callable[..., float] | None = field(default=None, repr=False)
    exponent: int = 1
    version: int = 1
    calibration: str = ""

    def weighted(self, *arrays: Array, **settings: object) -> tuple[float, float]:
        """Weight times value of a batch, and its weight: the function's arrays by position, all else by keyword.

        The metric over all batches is (Σ weight · value / Σ weight) ** (1 / exponent). Raises `ValueError` for a metric
        that is no mean, and for a batch whose value is NaN or whose weight is not positive.
        """
        if self.weight is None:
            raise ValueError(f"{self.name} is not a mean over batches: its function needs all samples")
        value, weight = self.function(*arrays, **settings), self.weight(*arrays)
        assert isinstance(value, float)
        if value != value or not 0 < weight < float("inf"):
            raise ValueError(f"{self.name}: a batch of value {value} and weight {weight} cannot be averaged")
        return weight * value**self.exponent, weight


def by_frames(first: Array, *_: Array) -> float:
    """Weight: number of frames (or samples), the first axis."""
    return float(len(first))


def by_clips(first: Array, *_: Array) -> float:
    """Weight: number of clips [*clips, frames, numbers]."""
    return float(np.prod(first.shape[:-2]))


def by_steps(order: int) -> Callable[..., float]:
    """Weight: number of differences of this order (0: of frames) in clips [*clips, frames, joints, 3]."""
    return lambda first, *_: float(np.prod(first.shape[:-3]) * (first.shape[-3] - order))
