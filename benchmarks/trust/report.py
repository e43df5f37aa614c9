"""What a part of the drill tried and what failed: as a table, as JSON, and in the file that collects all parts."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from rich.markup import escape
from rich.table import Table

from motionkit.cli.console import stdout

SHOWN_FAILURES = 20


@dataclass(frozen=True)
class Case:
    """One kind of trial: the number of trials, and each failure in one line that says how to repeat it.

    `figures` holds further numbers (the longest trial in seconds …); `skipped` says why a case could not be tried.
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
    def tried(self) -> int:
        """Number of trials of all cases."""
        return sum(case.tried for case in self.cases)

    @property
    def failures(self) -> tuple[str, ...]:
        """All failures, each with the name of its case."""
        return tuple(f"{case.name}: {failure}" for case in self.cases for failure in case.failures)

    def plain(self) -> dict[str, Any]:
        """The report as JSON holds it, with its sums."""
        return {**asdict(self), "tried": self.tried, "failed": len(self.failures)}


def print_report(report: Report) -> None:
    """Print a table of the cases and then the failures, on stdout."""
    table = Table(title=f"{report.part}, seed {report.seed}, {report.seconds:.0f} s", title_justify="left")
    for heading in ("case", "tried", "failed", ""):
        table.add_column(heading, justify="right" if heading in ("tried", "failed") else "left")
    for case in report.cases:
        figures = ", ".join(f"{name} {value:.4g}" for name, value in case.figures.items())
        note = f"skipped: {case.skipped}" if case.skipped else figures
        table.add_row(escape(case.name), f"{case.tried:,}", f"{len(case.failures):,}", escape(note))
    table.add_section()
    table.add_row("all", f"{report.tried:,}", f"{len(report.failures):,}", "")
    stdout.print(table)
    for failure in report.failures[:SHOWN_FAILURES]:
        stdout.print(failure)
    if len(report.failures) > SHOWN_FAILURES:
        stdout.print(f"… and {len(report.failures) - SHOWN_FAILURES:,} more: --json names them all")


def store_report(report: Report, path: Path) -> None:
    """Add a report to a JSON file of reports by part; the reports of other parts in it are kept."""
    reports = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    reports[report.part] = report.plain()
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(dict(sorted(reports.items())), indent=2, allow_nan=False, ensure_ascii=False)
    path.write_text(f"{text}\n", encoding="utf-8")
