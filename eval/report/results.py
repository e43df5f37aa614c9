"""Results: one JSON file per table, with every number's definition and provenance, and the differences of its rows."""

import json
import math
import os
import re
import shlex
import sys
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from html import escape
from itertools import combinations
from pathlib import Path
from typing import Any, Literal, get_args

from eval.metrics.metric import Metric
from eval.metrics.number import Number
from eval.metrics.registry import find_metric
from eval.sets.sets import RowId
from motionkit.core.errors import MotionkitError, shown
from motionkit.core.files import read_json, write_json
from motionkit.store.commit import read_manifest
from motionkit.training.run import RunFolder, commit, versions

FORMAT = "motionkit-result/1"
SIGNIFICANT_DIGITS, MAX_DECIMALS = 3, 6
# The name of a result's or figure's file, without a folder.
_FILE_NAME = re.compile(r"\w[\w.+-]*", re.ASCII)
FORMAT_OF_ANY_VERSION = FORMAT.rpartition("/")[0] + "/"
HINT = "run the evaluation again, or restore the file from a copy"
Origin = Literal["ours", "reference", "paper"]
DIFFERENCES = ": differences between rows"
"""End of the title of a block that compares another block's rows."""


class ResultError(MotionkitError):
    """A result file that cannot be read."""


@dataclass(frozen=True)
class Cell:
    """One number: `ci95` is half the width of its 95 % interval (None: unknown), `details` further metrics by name.

    A count is an int, shown with all its digits. `mark` is shown after it; the block's note explains it.
    """

    value: float | int
    ci95: float | None = None
    details: Mapping[str, float | int] = field(default_factory=dict)
    mark: str = ""


def cell_of(number: Number, details: Mapping[str, float | int] = {}, mark: str = "") -> Cell:
    """A number as a cell, without its interval if there is none."""
    return Cell(number.value, number.ci95 or None, details, mark)


def format_number(value: float | int) -> str:
    """Three significant digits, without exponents between 1e-4 and 1e6; a count with all its digits."""
    if isinstance(value, int):
        return f"{value:,}"
    decimals = _decimals(value)
    return f"{value:.2e}" if decimals is None else f"{value:.{decimals}f}"


def _decimals(value: float | int) -> int | None:
    """Number of decimals for three significant digits; None if an exponent is better."""
    if value == 0:
        return 0
    # The magnitude after rounding: 0.9999 shows as 1.00.
    magnitude = math.floor(math.log10(abs(float(f"{value:.{SIGNIFICANT_DIGITS - 1}e}"))))
    return max(0, SIGNIFICANT_DIGITS - 1 - magnitude) if -4 <= magnitude < 6 else None


def format_cell(cell: Cell | None, as_printed: bool = False) -> str:
    """`0.123 ± 0.004` with as many decimals on both sides, and its mark, or a dash; a paper's keeps its own digits."""
    if cell is None:
        return "–"
    if as_printed:
        return f"{cell.value:g}" if cell.ci95 is None else f"{cell.value:g} ± {cell.ci95:g}"
    if cell.ci95 is None:
        return f"{format_number(cell.value)}{cell.mark}"
    decimals = _decimals(cell.value)
    if decimals is None:
        return f"{cell.value:.2e} ± {cell.ci95:.2e}{cell.mark}"
    # At least one significant digit of the half-width, so that a nonzero one never shows as 0.
    leading = -math.floor(math.log10(cell.ci95)) if cell.ci95 > 0 else 0
    decimals = max(decimals, min(leading, MAX_DECIMALS))
    return f"{cell.value:.{decimals}f} ± {cell.ci95:.{decimals}f}{cell.mark}"


@dataclass(frozen=True)
class Row:
    """One line of a table; a column that is absent from `cells` has no number.

    `origin`: "ours" was computed here, "reference" was computed here from real motion, "paper" is printed in a paper.
    """

    name: str
    origin: Origin
    cells: Mapping[str, Cell]
    note: str = ""


@dataclass(frozen=True)
class Measure:
    """The metric of a block's numbers, as it is declared; `column` is empty if all columns are of one metric.

    `unit` is the block's, `better` the direction of better numbers: "lower", "higher", or "as real".
    """

    metric: str
    title: str
    unit: str
    better: Literal["lower", "higher", "as real"]
    source: str
    version: int = 1
    calibration: str = ""
    column: str = ""


def measure(metric: Metric | str, *, unit: str | None = None, column: str = "") -> Measure:
    """The `Measure` of a metric (or its name), in `unit` if given."""
    known = find_metric(metric) if isinstance(metric, str) else metric
    better: dict[bool | None, Literal["lower", "higher", "as real"]] = {True: "higher", False: "lower", None: "as real"}
    facts = (known.name, known.title, known.unit if unit is None else unit, better[known.higher_is_better])
    return Measure(*facts, known.source, known.version, known.calibration, column)


@dataclass(frozen=True)
class Block:
    """Comparable rows; numbers of different blocks are not comparable.

    `differences_of` is the title of the block whose rows it compares, "" for a block of scores.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[Row, ...]
    lower_is_better: bool = True
    note: str = ""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    metrics: tuple[Measure, ...] = ()
    differences_of: str = ""

    def texts(self) -> list[tuple[str, list[str]]]:
        """The rows as they are shown: a name, and the text of each column."""
        return [
            (row.name, [format_cell(row.cells.get(column), row.origin == "paper") for column in self.columns])
            for row in self.rows
        ]


@dataclass(frozen=True)
class Result:
    """One table: blocks of rows, the definition of its numbers, what is missing, and the provenance.

    `task` names it ("nerm-table2"), `version` is incremented when its meaning changes. `provenance` holds store, run,
    seed, environment. `figure` is the name of an image beside the file, "" if there is none.
    """

    task: str
    version: str
    title: str
    caption: str
    blocks: tuple[Block, ...]
    definition: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    figure: str = ""

    def _repr_html_(self) -> str:
        """The tables' numbers, for notebooks."""
        found = [f"<h3>{escape(self.title)}</h3><p>{escape(self.caption)}</p>"]
        for block in self.blocks:
            lines = [("", *block.columns), *((name, *texts) for name, texts in block.texts())]
            table = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in line)}</tr>" for line in lines)
            found.append(f"<h4>{escape(block.title)}</h4><table>{table}</table>")
        return "".join(found)


DIFFERENCES_NOTE = (
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


def score_differences(
    rows: Mapping[RowId, Mapping[str, Number]], column_of: Mapping[str, str], references: Collection[RowId] = ()
) -> Differences:
    """Differences of all pairs of rows that are no references, and from these; `column_of` maps metrics to columns."""
    found: dict[tuple[RowId, RowId], dict[str, Number]] = {}
    for first, second in pairs_of((row for row in rows if row not in references), references):
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
    rows = []
    for (first, second), found in differences.items():
        cells = {column: Cell(each.value, each.ci95) for column, each in found.items()}
        rows += [Row(f"{first} − {second}", "ours", cells, said(found, block.metrics))] if found else []
    if not rows:
        return None
    compared = Block(block.title + DIFFERENCES, block.columns, tuple(rows), note=DIFFERENCES_NOTE)
    return replace(compared, metrics=block.metrics, differences_of=block.title)


def with_differences(block: Block, differences: Differences, best: Iterable[str] = ()) -> list[Block]:
    """A block, and one of the informative differences between its rows if there are any (`of_interest`)."""
    tests = differences_block(block, of_interest(block, differences, best))
    return [block] if tests is None else [block, tests]


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


def environment() -> dict[str, Any]:
    """Versions, processors, time, the command, and the commit in a git checkout."""
    return {
        "command": _command(sys.argv),
        "versions": versions(),
        "processors": os.cpu_count(),
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "commit": commit(),
    }


def _command(words: list[str]) -> str:
    """A command line with absolute paths reduced to file names."""
    program = Path(words[0]).name if words else ""
    return shlex.join([program, *(re.sub(r"(^|=)/(?:[^/]+/)*", r"\1", word) for word in words[1:])])


def provenance(store: Path | None = None, runs: Iterable[Path] = ()) -> dict[str, Any]:
    """Provenance of figures: a store's fingerprint, the sha256 of the weights of every stage of some runs, environment.

    Raises `StoreError` for a missing store.
    """
    stages = {run: sorted(path.name for path in run.iterdir()) for run in runs}
    weights = {run.name: RunFolder(run).fingerprints(names) for run, names in stages.items()}
    found = {} if store is None else {"store": {"path": store.name, "fingerprint": read_manifest(store).fingerprint}}
    return {**found, "weights_sha256": weights, "environment": environment()}


def write_result(result: Result, folder: Path) -> Path:
    """Write `folder/TASK.json` atomically; raises `ValueError` for NaN."""
    path = folder / f"{result.task}.json"
    write_json(path, {"format": FORMAT, **asdict(result)})
    return path


def read_result(path: Path | str) -> Result:
    """Read what `write_result` wrote.

    Raises `DamagedFileError` for a damaged file, `ResultError` for other files or another version.
    """
    try:
        document = read_json(Path(path), HINT)
        if (found := document.pop("format", None)) != FORMAT:
            raise ValueError(f"not a result of format {FORMAT} (found {shown(found)})")
        texts = {key: _texts(document.pop(key)) for key in ("notes", "missing")}
        result = Result(**document | texts | {"blocks": tuple(map(_block, document["blocks"]))})
        _require(str, result.task, result.version, result.title, result.caption, result.figure)
        _require(dict, result.definition, result.provenance)
        for name in (result.task, result.figure or result.task):
            if not _FILE_NAME.fullmatch(name):
                raise ValueError(f"{shown(name)} where a file's name was expected")
        return result
    except (AttributeError, KeyError, TypeError, ValueError, OSError) as error:
        raise ResultError(f"{path}: cannot be read as a result: {error!r}; run the evaluation again") from None


@dataclass(frozen=True)
class FoundResults:
    """Contents of a folder: results by task, why other results could not be read, and other JSON files."""

    results: tuple[Result, ...] = ()
    faults: tuple[str, ...] = ()
    others: tuple[Path, ...] = ()


def find_results(folder: Path) -> FoundResults:
    """Read every result in a folder; a file that is not valid JSON counts as an unreadable result."""
    results, faults, others = [], [], []
    for path in sorted(folder.glob("*.json")):
        try:
            with suppress(ValueError, RecursionError):
                document = json.loads(path.read_bytes())
                kind = document.get("format") if isinstance(document, dict) else None
                if not str(kind).startswith(FORMAT_OF_ANY_VERSION):
                    others.append(path)
                    continue
            results.append(read_result(path))
        except (MotionkitError, OSError) as error:
            faults.append(str(error))
    return FoundResults(tuple(results), tuple(faults), tuple(others))


def _block(document: dict[str, Any]) -> Block:
    rows = tuple(map(_row, document["rows"]))
    # Older results, which our pages show, declare no metrics, and name what is compared in a block's title alone.
    metrics = tuple(Measure(**each) for each in document.get("metrics", ()))
    compared, ending, _ = document["title"].rpartition(DIFFERENCES)
    known = {"differences_of": compared if ending else "", **document}
    block = Block(**known | {"rows": rows, "columns": _texts(document["columns"]), "metrics": metrics})
    for each in metrics:
        _require(str, *(value for name, value in vars(each).items() if name != "version"))
    _require(str, block.title, block.note, block.differences_of)
    _require(dict, block.provenance)
    _require(bool, block.lower_is_better)
    return block


def _row(document: dict[str, Any]) -> Row:
    row = Row(**{**document, "cells": {column: parse_cell(cell) for column, cell in document["cells"].items()}})
    _require(str, row.name, row.note, row.origin)
    if row.origin not in get_args(Origin):
        raise ValueError(f"{row.origin[:40]!r}, expected one of {', '.join(get_args(Origin))}")
    return row


def parse_cell(document: dict[str, Any]) -> Cell:
    """A cell from JSON; raises `TypeError`, `ValueError` or `AttributeError` for anything but finite numbers."""
    cell = Cell(**document)
    for value in (cell.value, *([] if cell.ci95 is None else [cell.ci95]), *cell.details.values()):
        if type(value) not in (int, float) or abs(value) > sys.float_info.max:
            raise ValueError(f"{str(value)[:40]} where a finite number was expected")
    return cell


def _texts(values: list[str]) -> tuple[str, ...]:
    _require(list, values)
    _require(str, *values)
    return tuple(values)


def _require(kind: type, *values: object) -> None:
    for value in values:
        if not isinstance(value, kind):
            raise TypeError(f"{str(value)[:40]!r} where a {kind.__name__} was expected")
