"""Blocks of the completion tables: rows by the form of their output, on each data set and pooled."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

from eval.completion.encoders import Completer
from eval.completion.scores import Scores, mean_over_takes, pooled
from eval.metrics.metric import find_metric
from eval.metrics.number import Number
from eval.report.results import Block, Cell, Differences, Measure, Row, cell_of, differences_block, measure, pairs_of
from eval.sets.sets import RowId

# Metrics shown in another unit than their own: the factor, and the unit's name.
UNITS = {"mpjpe_global": (100.0, "cm")}
PLAIN = "plain"
# Suffix of a block's title for each form; corrections share a block with interpolators.
FORMS = {"": "", PLAIN: ", plain answers"}


@dataclass(frozen=True)
class Shown:
    """The layout of a table: blocks by metric, with their titles, and further metrics of a block by title."""

    columns: tuple[str, ...]
    metrics: Mapping[str, str]
    details: Mapping[str, Mapping[str, str]]


@dataclass(frozen=True, eq=False)
class Scope:
    """The clips that figures are averaged over: of one data set, or of several."""

    label: str
    fps: Fraction
    rows: Mapping[str, Scores]
    note: str = ""


def with_pools(scopes: Sequence[Scope], noun: str) -> list[Scope]:
    """Add pooled scopes, first, for framerates that several data sets have; `noun` is what is pooled (clips)."""
    pools = []
    for fps in dict.fromkeys(scope.fps for scope in scopes):
        same = [scope for scope in scopes if scope.fps == fps]
        if len(same) > 1:
            names = ", ".join(scope.label for scope in same)
            note = f"All {noun} of {names}: each counts alike, and is scaled as in its own data set's block."
            rows = pooled([scope.rows for scope in same])
            pools.append(Scope(f"all data sets, {float(fps):g} fps", fps, rows, note))
    return [*pools, *scopes]


def blocks_of(scopes: Iterable[Scope], completers: Sequence[Completer], shown: Shown) -> list[Block]:
    """Blocks of every scope, with paired differences; rows are described in the first block of each form.

    Trained rows that predict poses directly (form `plain`) have their own blocks. Rows that need no training are in
    both.
    """
    blocks: list[Block] = []
    noted: set[str] = set()
    for scope in scopes:
        for form, of_form in _by_form([each for each in completers if each.name in scope.rows]).items():
            for metric, title in shown.metrics.items():
                notes = form not in noted and metric == next(iter(shown.metrics))
                blocks.append(
                    Block(
                        f"{scope.label}{FORMS[form]}: {title}",
                        shown.columns,
                        tuple(
                            Row(each.name, "ours", _cells(scope.rows[each.name], metric, shown), each.note * notes)
                            for each in of_form
                        ),
                        lower_is_better=find_metric(metric).higher_is_better is False,
                        note=scope.note,
                        metrics=(shown_measure(metric),),
                    )
                )
                found = _differences(scope, of_form, metric, shown)
                tests = differences_block(blocks[-1], found)
                blocks += [] if tests is None else [tests]
            noted.add(form)
    return blocks


def _by_form(completers: Sequence[Completer]) -> dict[str, list[Completer]]:
    """Rows of each form's blocks; corrections and rows of unknown form share one, which always exists."""
    forms: dict[str, list[Completer]] = {"": [each for each in completers if each.form != PLAIN]}
    if any(each.form == PLAIN for each in completers):
        forms[PLAIN] = [each for each in completers if not each.trained or each.form == PLAIN]
    return forms


def _cells(scores: Scores, metric: str, shown: Shown) -> dict[str, Cell]:
    further = shown.details.get(metric, {})
    cells = {}
    for column in shown.columns:
        details = {title: number(scores, name, column).value for name, title in further.items()}
        cells[column] = cell_of(number(scores, metric, column), details)
    return cells


def _differences(scope: Scope, completers: Sequence[Completer], metric: str, shown: Shown) -> Differences:
    """Differences between trained rows, and from the untrained row that is best in most columns."""
    trained = [each.name for each in completers if each.trained]
    untrained = [each.name for each in completers if not each.trained]
    best = [_best_of(untrained, scope, metric, shown.columns)] if untrained else []
    found: dict[tuple[RowId, RowId], dict[str, Number]] = {}
    for first, second in pairs_of(map(RowId, trained), [*map(RowId, best)]):
        for column in shown.columns:
            numbers = (number(scope.rows[row.system], metric, column) for row in (first, second))
            if (less := Number.less(*numbers)) is not None:
                found.setdefault((first, second), {})[column] = less
    return found


def _best_of(names: Sequence[str], scope: Scope, metric: str, columns: Sequence[str]) -> str:
    """The row that is best in most columns."""
    sign = -1.0 if find_metric(metric).higher_is_better else 1.0
    places = [
        min((sign * number(scope.rows[name], metric, column).value, place) for place, name in enumerate(names))[1]
        for column in columns
    ]
    return names[Counter(places).most_common(1)[0][0]]


def number(scores: Scores, metric: str, column: str) -> Number:
    """A metric's number in the unit shown in tables."""
    found, (factor, _) = mean_over_takes(scores[metric][column]), UNITS.get(metric, (1.0, ""))
    resampled = tuple(None if each is None else factor * each for each in found.resampled)
    return Number(factor * found.value, factor * found.ci95, resampled)


def shown_measure(metric: str) -> Measure:
    """A metric's description in a block."""
    return measure(metric, unit=UNITS[metric][1] if metric in UNITS else None)
