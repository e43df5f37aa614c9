"""One number of a table and its uncertainty; the numbers of a set of motions under a protocol."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

Resampled = tuple[float | None, ...]
"""A number in every resampling of the takes; None if a resampling drew none of its samples."""

NORMAL_95 = 1.96
Verdict = Literal["lower", "higher", "not told apart"]


def half_width(resampled: Resampled) -> float | None:
    """1.96 standard deviations of a number's resamplings; None if no two of them differ.

    Not the quantiles: distances of distributions are larger for the fewer distinct takes of a resampling, so its
    quantiles lie above the number itself (docs/deviations.md has the coverage).
    """
    values = [value for value in resampled if value is not None]
    return float(NORMAL_95 * np.std(values, ddof=1)) if len(set(values)) > 1 else None


@dataclass(frozen=True)
class Number:
    """A number; `ci95` is half the width of its 95 % interval, 0 if there is none.

    `resampled` are its values in the bootstrap over takes; () without one. `drawing` is the half-width over the
    replications of a protocol alone, `details` are further numbers by name.
    """

    value: float
    ci95: float = 0.0
    resampled: Resampled = ()
    drawing: float = 0.0
    details: Mapping[str, float] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.value:.4g} ± {self.ci95:.2g}"

    def less(self, other: "Number") -> "Number | None":
        """This number minus another, with the interval of the same resampled takes; None if either has none."""
        if len(self.resampled) != len(other.resampled):
            return None
        pairs = zip(self.resampled, other.resampled, strict=True)
        width = half_width(tuple(None if a is None or b is None else a - b for a, b in pairs))
        return None if width is None else Number(self.value - other.value, width)

    @property
    def verdict(self) -> Verdict:
        """Of a difference: whether the interval excludes 0, and on which side it lies."""
        if abs(self.value) <= self.ci95:
            return "not told apart"
        return "lower" if self.value < 0 else "higher"


def over_replications(values: Sequence[float], resampled: Resampled = ()) -> Number:
    """Mean over R replications ± 1.96·std(ddof 0)/√R (text-to-motion final_evaluations.py).

    With resampled takes the interval is over both. Raises `ValueError` for no replications or one that is not finite.
    """
    if not len(values):
        raise ValueError("there are no replications to average")
    array = np.asarray(values, dtype=np.float64)
    if not np.isfinite(array).all():
        raise ValueError(f"a replication is not finite: {array.tolist()}")
    drawing, width = float(NORMAL_95 * array.std() / np.sqrt(array.size)), half_width(resampled)
    return Number(
        float(array.mean()), drawing if width is None else float(np.hypot(width, drawing)), resampled, drawing
    )


def with_takes(value: float, resampled: Resampled) -> Number:
    """A number with its interval over takes."""
    return Number(value, half_width(resampled) or 0.0, resampled)


@dataclass
class Scores:
    """Metrics of a set of motions by their names in `eval.metrics.metric`, collected over a protocol's replications.

    `sizes` are the numbers of samples; `remarks` state where the data has less than the protocol requires, and what
    was left out because of it.
    """

    replications: dict[str, list[float]] = field(default_factory=dict)
    resampled: dict[str, Resampled] = field(default_factory=dict)
    sizes: dict[str, int] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)

    def add(self, name: str, value: float) -> None:
        """Add a replication of a metric."""
        self.replications.setdefault(name, []).append(value)

    def remark(self, text: str) -> None:
        """Add a remark, once."""
        if text not in self.remarks:
            self.remarks.append(text)

    def remark_on_draws(self, draws: int, replications: int) -> None:
        """Add a remark on the interval if there are fewer sets of motions than replications."""
        if draws < replications:
            sets = "is one set" if draws == 1 else f"are {draws} sets"
            self.remark(
                f"there {sets} of motions for {replications} replications: intervals are over takes and hold the draws "
                "of pools and pairs, other generations of the same takes no more than these differ (--draws)"
            )

    @property
    def values(self) -> dict[str, Number]:
        """Every metric's number; raises `ValueError` for a replication that is not finite."""
        return {
            name: over_replications(values, self.resampled.get(name, ())) for name, values in self.replications.items()
        }
