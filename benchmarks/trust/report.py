"""What a part of the drill tried and what failed."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True)
class Case:
    """One kind of trial: the number of trials, and each failure in one line that says how to repeat it.

    `figures` holds further numbers; `skipped` says why a case could not be tried.
    """

    name: str
    tried: int
    failures: tuple[str, ...] = ()
    figures: Mapping[str, float] = field(default_factory=dict)
    skipped: str = ""


@dataclass(frozen=True)
class Report:
    """One part of the drill, after it ran."""

    part: str
    seed: int
    seconds: float
    cases: tuple[Case, ...]
    environment: Mapping[str, Any]

    @property
    def failures(self) -> tuple[str, ...]:
        """All failures, each with the name of its case."""
        return tuple(f"{case.name}: {failure}" for case in self.cases for failure in case.failures)

    def plain(self) -> dict[str, Any]:
        """The report as JSON holds it, with its sums."""
        return {**asdict(self), "tried": sum(case.tried for case in self.cases), "failed": len(self.failures)}
