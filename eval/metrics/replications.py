"""Scores of a protocol: every metric's value in every replication, and the numbers of samples."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from eval.metrics.checks import Estimate, estimate, variance_spread
from eval.metrics.resampling import Difference, Resampled, half_width, paired_difference


@dataclass(frozen=True)
class Score:
    """One metric's values, one per replication; raises `ValueError` for none or one that is not finite.

    `resampled` are its values in the bootstrap over takes; () if these are not known.
    """

    values: tuple[float, ...]
    resampled: Resampled = ()

    def __post_init__(self) -> None:
        estimate(self.values)

    @property
    def drawing(self) -> Estimate:
        """Mean ± 1.96·std/√R over the replications: the variation by pools, pairs and generations of the protocol."""
        return estimate(self.values)

    @property
    def estimate(self) -> Estimate:
        """Mean ± half the 95 % interval over takes and replications; over replications alone if takes are not known."""
        drawing, width = self.drawing, half_width(self.resampled)
        return drawing if width is None else replace(drawing, ci95=float(np.hypot(width, drawing.ci95)))

    def less(self, other: "Score") -> Difference | None:
        """This score's mean minus another row's, with the same resampled takes; None without them."""
        return paired_difference(self.drawing.mean, self.resampled, other.drawing.mean, other.resampled)

    @property
    def variance_spread(self) -> float:
        """1.96 · variance over the replications, which ACTOR prints after "±"."""
        return variance_spread(self.values)


@dataclass(frozen=True)
class Scores:
    """Metrics by their names in `eval.metrics.metric`; `sizes` are the numbers of samples.

    `remarks` says where the data has less than the protocol asks for, and what was left out because of it.
    """

    protocol: str
    values: Mapping[str, Score]
    sizes: Mapping[str, int]
    remarks: tuple[str, ...] = ()


@dataclass
class Tally:
    """Scores under construction."""

    values: dict[str, list[float]] = field(default_factory=dict)
    resampled: dict[str, Resampled] = field(default_factory=dict)
    remarks: dict[str, None] = field(default_factory=dict)

    def add(self, name: str, value: float) -> None:
        """Add a replication of a metric."""
        self.values.setdefault(name, []).append(value)

    def remark(self, text: str) -> None:
        """Add a remark, once."""
        self.remarks[text] = None

    def remark_on_draws(self, draws: int, replications: int) -> None:
        """Add a remark on the interval if there are fewer sets of motions than replications."""
        if draws < replications:
            sets = "is one set" if draws == 1 else f"are {draws} sets"
            self.remark(
                f"there {sets} of motions for {replications} replications: intervals are over takes and hold the draws "
                "of pools and pairs, other generations of the same takes no more than these differ (--draws)"
            )

    def scores(self, protocol: str, sizes: Mapping[str, int], remarks: Sequence[str]) -> Scores:
        """The scores, with the protocol's own remarks first."""
        values = {name: Score(tuple(values), self.resampled.get(name, ())) for name, values in self.values.items()}
        return Scores(protocol, values, dict(sizes), tuple(dict.fromkeys((*remarks, *self.remarks))))
