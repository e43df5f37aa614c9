"""Scores of one row on one data set, kept in RESULTS/parts for every table that has the row."""

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from eval.completing.scores import Scores
from eval.metrics.streaming import MeanSums
from eval.report.results import Cell
from eval.tables.parts import Part, find_part, keep_part
from motionkit.core.warn import warn

WEIGHT = "weight"


def find_scores(
    results: Path, name: str, terms: Mapping[str, Any], metrics: Collection[str], columns: Collection[str]
) -> Scores | None:
    """The scores of these metrics and columns that were kept for the terms; None where there are none."""
    part = find_part(results, _name(name), terms)
    if part is None:
        return None
    try:
        return {metric: {column: _sums(part.rows[metric][column]) for column in columns} for metric in metrics}
    except KeyError as error:
        warn(f"a kept part of {name} lacks {error}: computing it anew")
        return None


def _sums(cell: Cell) -> MeanSums:
    return MeanSums().added(cell.value, cell.details[WEIGHT])


def keep_scores(results: Path, name: str, terms: Mapping[str, Any], scores: Scores) -> None:
    """Write scores for `find_scores`: means, and the weights by which those of other clips join them."""
    rows = {
        metric: {column: Cell(sums.mean, None, {WEIGHT: sums.weight}) for column, sums in columns.items()}
        for metric, columns in scores.items()
    }
    keep_part(results, _name(name), terms, Part(rows))


def _name(table: str) -> str:
    return f"{table}-means"
