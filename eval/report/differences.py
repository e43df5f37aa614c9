"""Which rows differ: differences of two rows' numbers with paired 95 % intervals, and what they allow to say."""

from collections.abc import Iterable, Mapping
from itertools import combinations

from eval.metrics.replications import Score
from eval.metrics.resampling import Difference
from eval.report.results import Block, Cell, Measure, Row

NOTE = (
    "A row's number less another's, ± half the 95 % interval: 1.96 standard deviations over resamplings that draw the "
    "same takes for both rows. One is said to be better only where the interval leaves out 0; nothing corrects for how "
    "many pairs there are."
)
DRAWING = "± over replications alone"
SUFFIX = ": differences between rows"
"""What stands behind a block's title in that of its rows' differences."""
# Differences of two rows (the first less the second) by column.
Differences = Mapping[tuple[str, str], Mapping[str, Difference]]


def pairs_of(rows: Iterable[str], references: Iterable[str] = ()) -> list[tuple[str, str]]:
    """Which rows are compared: each with every later one, and with the references."""
    own = list(rows)
    return [*combinations(own, 2), *((row, reference) for row in own for reference in references)]


def score_differences(rows: Mapping[str, Mapping[str, Score]], column_of: Mapping[str, str]) -> Differences:
    """Of every two rows' metrics, which are named by `column_of` for their columns."""
    found: dict[tuple[str, str], dict[str, Difference]] = {}
    for first, second in pairs_of(rows):
        for name, column in column_of.items():
            if name in rows[first] and name in rows[second]:
                less = rows[first][name].less(rows[second][name])
                if less is not None:
                    found.setdefault((first, second), {})[column] = less
    return found


def of_interest(block: Block, differences: Differences, best: Iterable[str] = ()) -> Differences:
    """Of the differences between all rows of a block those that say something; nearly all pairs of many rows do not.

    They hold the best row of a column or a reference, or the same motions treated in two ways, whose names begin alike
    ("X" and "X, planted"). `best` names the best rows where the columns do not. Where no row can be best, all are.
    """
    best = {*best} or {names[0] for names in _ranked(block).values()}
    shown = best | {row.name for row in block.rows if row.origin == "reference"}
    return {
        pair: found
        for pair, found in differences.items()
        if not best or shown & {*pair} or pair[0].startswith(pair[1]) or pair[1].startswith(pair[0])
    }


def differences_block(block: Block, differences: Differences) -> Block | None:
    """A row for each pair of a block's rows, and what it allows to say; None where there is no pair."""
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
    return Block(block.title + SUFFIX, block.columns, rows, note=NOTE, metrics=block.metrics)


def _ranked(block: Block) -> dict[str, list[str]]:
    """By column a block's own rows, the best one first; none of columns where real motion's number is best."""
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


def said(found: Mapping[str, Difference], metrics: tuple[Measure, ...]) -> str:
    """In which columns the first row is better, worse, or not told apart; "lower" and "higher" where neither is better.

    A metric holds for the column that it names, or for all where it names none.
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
    """By column the best of a block's own rows and those that the paired test does not tell from it.

    `blocks` are all of the result, that of the block's differences among them. Columns have none where the best is
    compared with no other row, or real motion's number is best.
    """
    tests = next((each for each in blocks if each.title == block.title + SUFFIX), None)
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
