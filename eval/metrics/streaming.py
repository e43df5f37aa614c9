"""Means over batches and ranks: what a stream keeps is a weighted sum and the sum of its weights."""

from dataclasses import dataclass


@dataclass(frozen=True)
class MeanSums:
    """Σ weight·value and Σ weight of the batches so far; without arguments, of none.

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
        """The mean over all batches. Raises `ValueError` where there are none."""
        if not self.weight:
            raise ValueError("there is nothing to average: no batch was added")
        return self.total / self.weight
