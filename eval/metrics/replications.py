"""What a protocol makes of embeddings: every metric's value in every replication, and how many samples it had."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from eval.metrics.checks import Estimate, estimate, variance_spread
from eval.metrics.resampling import Difference, Resampled, half_width, paired_difference


@dataclass(frozen=True)
class Score:
    """One metric's values, a replication each; raises `ValueError` for none or one that is not finite.

    `resampled` are its values with other takes; () where these are not known.
    """

    values: tuple[float, ...]
    resampled: Resampled = ()

    def __post_init__(self) -> None:
        estimate(self.values)

    @property
    def drawing(self) -> Estimate:
        """Mean ± 1.96·std/√R over the replications: how much pools, pairs and generations of the protocol differ."""
        return estimate(self.values)

    @property
    def estimate(self) -> Estimate:
        """Mean ± half the 95 % interval over takes and replications; over replications alone where no take is known."""
        drawing, width = self.drawing, half_width(self.resampled)
        return drawing if width is None else replace(drawing, ci95=float(np.hypot(width, drawing.ci95)))

    def less(self, other: "Score") -> Difference | None:
        """This score's mean less another row's, by the same resampled takes; None without them."""
        return paired_difference(self.drawing.mean, self.resampled, other.drawing.mean, other.resampled)

    @property
    def variance_spread(self) -> float:
        """1.96 · variance over the replications, which ACTOR prints after "±"."""
        return variance_spread(self.values)


@dataclass(frozen=True)
class Scores:
    """Metrics by their names in `eval.metrics.metric`; `sizes` counts what they were computed on.

    `remarks` says where the data gave less than the protocol asks for, and what was left out because of it.
    """

    protocol: str
    values: Mapping[str, Score]
    sizes: Mapping[str, int]
    remarks: tuple[str, ...] = ()


@dataclass
class Tally:
    """Scores while they are being made."""

    values: dict[str, list[float]] = field(default_factory=dict)
    resampled: dict[str, Resampled] = field(default_factory=dict)
    remarks: dict[str, None] = field(default_factory=dict)

    def add(self, name: str, value: float) -> None:
        """One more replication of a metric."""
        self.values.setdefault(name, []).append(value)

    def remark(self, text: str) -> None:
        """Say something, once."""
        self.remarks[text] = None

    def remark_on_draws(self, draws: int, replications: int) -> None:
        """Say what an interval does not hold where there are fewer sets of motions than replications."""
        if draws < replications:
            sets = "is one set" if draws == 1 else f"are {draws} sets"
            self.remark(
                f"there {sets} of motions for {replications} replications: intervals are over takes and hold the draws "
                "of pools and pairs, other generations of the same takes no more than these differ (--draws)"
            )

    def scores(self, protocol: str, sizes: Mapping[str, int], remarks: Sequence[str]) -> Scores:
        """All of it, the protocol's own remarks first."""
        values = {name: Score(tuple(values), self.resampled.get(name, ())) for name, values in self.values.items()}
        return Scores(protocol, values, dict(sizes), tuple(dict.fromkeys((*remarks, *self.remarks))))
