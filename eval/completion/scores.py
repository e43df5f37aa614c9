"""Scores of a completion table: sums of metrics over takes, their means, and the blocks that show them."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import product

import numpy as np

from eval.completion.encoders import Completer
from eval.metrics.intervals import Number, quotients, resampling_weights, with_takes
from eval.metrics.registry import find_metric
from eval.report.results import Block, Cell, Measure, Row, cell_of, differences_block, measure, score_differences
from eval.sets.sets import RowId
from motionkit.core.shapes import Shaped

Scores = dict[tuple[str, str], dict[str, list[float]]]
"""By metric and column (a scale, a length), by take: Σ weight·value and Σ weight of its clips."""

# Metrics shown in another unit than their own: the factor, and the unit's name.
UNITS = {"mpjpe_global": (100.0, "cm")}


def add_clips(
    scores: Scores,
    column: str,
    takes: Sequence[str],
    metric: str,
    *arrays: Shaped[np.ndarray, "_clips ..."],
    **settings: object,
) -> None:
    """Add clips, each of a take, to a metric's sums of these takes; settings are the metric's own."""
    by_take = scores.setdefault((metric, column), {})
    for take in dict.fromkeys(takes):
        clips = [clip for clip, each in enumerate(takes) if each == take]
        batch = find_metric(metric).weighted(*(array[clips] for array in arrays), **settings)
        by_take[take] = [before + own for before, own in zip(by_take.get(take, (0.0, 0.0)), batch, strict=True)]


def mean_over_takes(by_take: Mapping[str, Sequence[float]]) -> Number:
    """The mean over clips, frames or true power, with its interval over takes; none for a single take."""
    totals, sizes = np.array(list(by_take.values())).T
    mean = sum(totals.tolist()) / sum(sizes.tolist())
    if len(by_take) < 2:
        return Number(mean)
    weights = resampling_weights([f"take {take}" for take in by_take])
    return with_takes(mean, quotients(weights @ totals, weights @ sizes))


@dataclass(frozen=True, eq=False)
class Scope:
    """The clips that figures are averaged over: of one data set, or of several."""

    label: str
    fps: Fraction
    rows: Mapping[str, Scores]
    note: str = ""

    def number(self, row: str, metric: str, column: str) -> Number:
        """A metric's number in the unit shown in tables."""
        mean, (factor, _) = mean_over_takes(self.rows[row][metric, column]), UNITS.get(metric, (1.0, ""))
        resampled = tuple(None if each is None else factor * each for each in mean.resampled)
        return Number(factor * mean.value, factor * mean.ci95, resampled)

    def cell(self, row: str, metric: str, column: str, details: Mapping[str, str]) -> Cell:
        """A cell of a metric's block; `details` are the titles of further metrics."""
        further = {title: self.number(row, name, column).value for name, title in details.items()}
        return cell_of(self.number(row, metric, column), further)


def shown_measure(metric: str) -> Measure:
    """A metric's description in a block."""
    return measure(metric, unit=UNITS.get(metric, (1.0, None))[1])


def with_pools(scopes: Sequence[Scope]) -> list[Scope]:
    """Add pooled scopes, first, for framerates that several data sets have.

    A pool has the clips of all its data sets, which have no take in common, for the rows that each of them has.
    """
    pools = []
    for fps in dict.fromkeys(scope.fps for scope in scopes):
        same = [scope for scope in scopes if scope.fps == fps]
        if len(same) > 1:
            names = ", ".join(scope.label for scope in same)
            note = f"All clips of {names}: each counts alike, and is scaled as in its own data set's block."
            rows: dict[str, Scores] = {row: {} for row in same[0].rows if all(row in scope.rows for scope in same)}
            for row, scope in product(rows, same):
                for key, by_take in scope.rows[row].items():
                    rows[row].setdefault(key, {}).update(by_take)
            pools.append(Scope(f"all data sets, {float(fps):g} fps", fps, rows, note))
    return [*pools, *scopes]


def blocks_of(
    scopes: Iterable[Scope],
    completers: Sequence[Completer],
    columns: tuple[str, ...],
    metrics: Mapping[str, str],
    details: Mapping[str, Mapping[str, str]],
) -> list[Block]:
    """Blocks of every scope and metric, with paired differences; rows are described in the first block of each form.

    `metrics` are titles of blocks by metric, `details` titles of further metrics by the metric of a block.

    Trained rows that predict poses directly (form `plain`) have their own blocks; corrections and rows of unknown form
    share one. Rows that need no training are in both.
    """
    blocks: list[Block] = []
    noted: set[str] = set()
    for scope in scopes:
        known = [each for each in completers if each.name in scope.rows]
        by_form = {"": [each for each in known if each.form != "plain"]}
        if any(each.form == "plain" for each in known):
            by_form[", plain answers"] = [each for each in known if not each.trained or each.form == "plain"]
        for form, rows in by_form.items():
            for metric, title in metrics.items():
                notes, further = form not in noted and metric == next(iter(metrics)), details.get(metric, {})
                cells = {
                    row.name: {column: scope.cell(row.name, metric, column, further) for column in columns}
                    for row in rows
                }
                block = Block(
                    f"{scope.label}{form}: {title}",
                    columns,
                    tuple(Row(row.name, "ours", cells[row.name], row.note * notes) for row in rows),
                    lower_is_better=find_metric(metric).higher_is_better is False,
                    note=scope.note,
                    metrics=(shown_measure(metric),),
                )
                differences = _differences(block, scope, rows, metric)
                blocks += [block] if differences is None else [block, differences]
            noted.add(form)
    return blocks


def _differences(block: Block, scope: Scope, rows: Sequence[Completer], metric: str) -> Block | None:
    """Differences between trained rows, and from the untrained row that is best in most columns."""
    untrained = [each.name for each in rows if not each.trained]
    sign = -1.0 if find_metric(metric).higher_is_better else 1.0
    wins = Counter(
        min(untrained, key=lambda name: sign * scope.number(name, metric, column).value)
        for column in (block.columns if untrained else ())
    )
    best = [name for name, _ in wins.most_common(1)]
    compared = [*(each.name for each in rows if each.trained), *best]
    numbers = {RowId(row): {each: scope.number(row, metric, each) for each in block.columns} for row in compared}
    columns = {column: column for column in block.columns}
    return differences_block(block, score_differences(numbers, columns, [RowId(name) for name in best]))
