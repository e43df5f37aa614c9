"""Metadata of metrics: unit, direction, source and, for means, the weights; sums of means."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.generic]


@dataclass(frozen=True)
class MeanSums:
    """Σ weight·value and Σ weight of the batches so far; the default has none.

    A weight is the number of things that a batch's value is a mean over (`Metric.weight` gives it).
    """

    total: float = 0.0
    weight: float = 0.0

    def added(self, value: float, weight: float) -> "MeanSums":
        """With one more batch. Raises `ValueError` for NaN or a weight that is not positive and finite."""
        if value != value or not 0 < weight < float("inf"):
            raise ValueError(f"a batch of value {value} and weight {weight} cannot be averaged")
        return MeanSums(self.total + weight * value, self.weight + weight)

    def merged(self, other: "MeanSums") -> "MeanSums":
        """With the batches of another rank."""
        return MeanSums(self.total + other.total, self.weight + other.weight)

    @property
    def mean(self) -> float:
        """The mean over all batches. Raises `ValueError` if there are none."""
        if not self.weight:
            raise ValueError("there is nothing to average: no batch was added")
        return self.total / self.weight


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

    def add(self, sums: MeanSums, *arrays: Array, **settings: object) -> MeanSums:
        """The sums with one more batch: the function's arrays by position, everything else by keyword.

        The metric over all batches is `sums.mean ** (1 / exponent)`. Raises `ValueError` for a metric that is no mean.
        """
        if self.weight is None:
            raise ValueError(f"{self.name} is not a mean over batches: its function needs all samples")
        value = self.function(*arrays, **settings)
        assert isinstance(value, float)
        return sums.added(value**self.exponent, self.weight(*arrays))


def by_frames(first: Array, *_: Array) -> float:
    """Weight: number of frames (or samples), the first axis."""
    return float(len(first))


def by_clips(first: Array, *_: Array) -> float:
    """Weight: number of clips [*clips, frames, numbers]."""
    return float(np.prod(first.shape[:-2]))


def by_steps(order: int) -> Callable[..., float]:
    """Weight: number of differences of this order along the frames of clips [*clips, frames, joints, 3]."""
    return lambda first, *_: float(np.prod(first.shape[:-3]) * (first.shape[-3] - order))


def by_clip_frames(first: Array, *_: Array) -> float:
    """Weight: number of frames of clips [clips, frames, …]."""
    return float(first.shape[0] * first.shape[1])
