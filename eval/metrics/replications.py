"""What a protocol makes of embeddings: every metric's value in every replication, and how many samples it had."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from eval.metrics.checks import Estimate, estimate, variance_spread


@dataclass(frozen=True)
class Score:
    """One metric's values, a replication each; raises `ValueError` for none or one that is not finite."""

    values: tuple[float, ...]

    def __post_init__(self) -> None:
        estimate(self.values)

    @property
    def estimate(self) -> Estimate:
        """Mean ± 1.96·std/√R over the replications."""
        return estimate(self.values)

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
                f"there {sets} of motions: the intervals over {replications} replications hold the draws of pools "
                "and pairs, not how much another generation would differ"
            )

    def scores(self, protocol: str, sizes: Mapping[str, int], remarks: Sequence[str]) -> Scores:
        """All of it, the protocol's own remarks first."""
        values = {name: Score(tuple(values)) for name, values in self.values.items()}
        return Scores(protocol, values, dict(sizes), tuple(dict.fromkeys((*remarks, *self.remarks))))
