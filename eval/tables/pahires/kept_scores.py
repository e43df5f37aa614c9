"""Scores of one row on one data set, kept in RESULTS/parts for every table that has the row."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from eval.completing.scores import Scores
from eval.metrics.streaming import MeanSums
from eval.report.results import Cell
from eval.tables.parts import Part, find_part, keep_part

WEIGHT = "weight"


def find_scores(results: Path, name: str, terms: Mapping[str, Any]) -> Scores | None:
    """The scores that were kept for these terms; None where there are none."""
    part = find_part(results, _name(name), terms)
    if part is None:
        return None
    return {
        metric: {column: MeanSums().added(cell.value, cell.details[WEIGHT]) for column, cell in cells.items()}
        for metric, cells in part.rows.items()
    }


def keep_scores(results: Path, name: str, terms: Mapping[str, Any], scores: Scores) -> None:
    """Write scores for `find_scores`: means, and the weights by which those of other clips join them."""
    rows = {
        metric: {column: Cell(sums.mean, None, {WEIGHT: sums.weight}) for column, sums in columns.items()}
        for metric, columns in scores.items()
    }
    keep_part(results, _name(name), terms, Part(rows))


def _name(table: str) -> str:
    return f"{table}-means"
