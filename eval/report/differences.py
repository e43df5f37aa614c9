"""Differences of two rows' numbers with paired 95 % intervals, and their verdicts."""

from collections.abc import Collection, Iterable, Mapping
from itertools import combinations

from eval.metrics.number import Number
from eval.report.results import DIFFERENCES, Block, Cell, Measure, Row
from eval.sets.row_ids import RowId

NOTE = (
    "A row's number less another's, ± half the 95 % interval: 1.96 standard deviations over resamplings that draw the "
    "same takes for both rows. One is said to be better only where the interval leaves out 0; nothing corrects for how "
    "many pairs there are."
)
DRAWING = "± over replications alone"
# Differences of two rows (the first minus the second) by column.
Differences = Mapping[tuple[RowId, RowId], Mapping[str, Number]]


def pairs_of(rows: Iterable[RowId], references: Collection[RowId] = ()) -> list[tuple[RowId, RowId]]:
    """The compared pairs of rows: each with every later one, and with the references."""
    own = list(rows)
    return [*combinations(own, 2), *((row, reference) for row in own for reference in references)]


def score_differences(rows: Mapping[RowId, Mapping[str, Number]], column_of: Mapping[str, str]) -> Differences:
    """Differences of all pairs of rows; `column_of` maps metrics to columns."""
    found: dict[tuple[RowId, RowId], dict[str, Number]] = {}
    for first, second in pairs_of(rows):
        for name, column in column_of.items():
            if name in rows[first] and name in rows[second]:
                less = rows[first][name].less(rows[second][name])
                if less is not None:
                    found.setdefault((first, second), {})[column] = less
    return found


def of_interest(block: Block, differences: Differences, best: Iterable[str] = ()) -> Differences:
    """Select the informative differences between the rows of a block.

    These are with the best row of a column or a reference, or of two variants of a system. `best` names the best rows
    if the columns do not. If no row can be best, all are.
    """
    best = {*best} or {names[0] for names in _ranked(block).values()}
    shown = best | {row.name for row in block.rows if row.origin == "reference"}
    return {
        (first, second): found
        for (first, second), found in differences.items()
        if not best or shown & {str(first), str(second)} or first.system == second.system
    }


def differences_block(block: Block, differences: Differences) -> Block | None:
    """A row for each pair of a block's rows, with its verdict; None if there is no pair."""
    rows = tuple(
        Row(
            f"{first} − {second}",
            "ours",
            {column: Cell(each.value, each.ci95) for column, each in found.items()},
            said(found, block.metrics),
        )
        for (first, second), found in differences.items()
        if found
    )
    if not rows:
        return None
    title = block.title + DIFFERENCES
    return Block(title, block.columns, rows, note=NOTE, metrics=block.metrics, differences_of=block.title)


def _ranked(block: Block) -> dict[str, list[str]]:
    """A block's own rows by column, best first; none for columns in which real motion's number is best."""
    by_column = {measure.column: measure.better for measure in block.metrics}
    found = {}
    for column in block.columns:
        better = by_column.get(column, by_column.get("", "as real"))
        numbers = {
            row.name: row.cells[column].value for row in block.rows if row.origin == "ours" and column in row.cells
        }
        if better != "as real" and numbers:
            found[column] = sorted(numbers, key=lambda name: numbers[name], reverse=better == "higher")
    return found


def said(found: Mapping[str, Number], metrics: tuple[Measure, ...]) -> str:
    """Columns in which the first row is better, worse, or no different; "lower" and "higher" if neither is better.

    A metric applies to the column that it names, or to all if it names none.
    """
    by_column = {measure.column: measure.better for measure in metrics}
    columns: dict[str, list[str]] = {}
    for column, each in found.items():
        best = by_column.get(column, by_column.get("", "as real"))
        verdict: str = each.verdict
        if verdict in ("lower", "higher") and best != "as real":
            verdict = "better" if verdict == best else "worse"
        columns.setdefault(verdict, []).append(column)
    return "; ".join(f"{verdict}: {', '.join(where)}" for verdict, where in sorted(columns.items()))


def best_in_column(block: Block, blocks: Iterable[Block]) -> dict[str, frozenset[str]]:
    """By column the best of a block's own rows and those not significantly different from it.

    `blocks` are all of the result, including the differences. Columns have none if the best row is compared with no
    other, or real motion's number is best.
    """
    tests = next((each for each in blocks if each.differences_of == block.title), None)
    if tests is None:
        return {}
    cells = {row.name: row.cells for row in tests.rows}
    found = {}
    for column, (best, *others) in _ranked(block).items():
        tested = {
            other: cells[pair][column]
            for other in others
            for pair in (f"{best} − {other}", f"{other} − {best}")
            if column in cells.get(pair, {})
        }
        if tested:
            alike = (other for other, less in tested.items() if less.ci95 is not None and abs(less.value) <= less.ci95)
            found[column] = frozenset([best, *alike])
    return found
