"""Results: one JSON file per table with the provenance of its numbers, differences of rows, and renderings."""

import base64
import csv
import io
import math
import os
import re
import shlex
import sys
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from html import escape
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from eval.metrics.intervals import Number
from eval.metrics.metric import Metric
from eval.metrics.registry import find_metric
from eval.sets.sets import RowId
from motionkit.core.errors import MotionkitError, UsageError, describe, shown
from motionkit.core.files import read_json, write_json
from motionkit.store.commit import read_manifest
from motionkit.training.config import from_plain
from motionkit.training.run import RunFolder, commit, versions

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMAT = "motionkit-result/1"
SIGNIFICANT_DIGITS, MAX_DECIMALS = 3, 6
# The name of a result's or figure's file, without a folder.
_FILE_NAME = re.compile(r"\w[\w.+-]*", re.ASCII)
HINT = "run the evaluation again, or restore the file from a copy"
Origin = Literal["ours", "reference", "paper"]
DRAWING = "± over replications alone"
DIFFERENCES = ": differences between rows"


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


def cell_of(number: Number, details: Mapping[str, float | int] = {}) -> Cell:
    """A number as a cell; the interval over replications alone is a detail if takes were resampled too.

    Replications that differ by no more than rounding, as FID of one set of motions does, make no interval.
    """
    drawn = number.drawing > 1e-9 * abs(number.value)
    if number.ci95 == number.drawing:
        return Cell(number.value, number.ci95 if drawn else None, details)
    return Cell(number.value, number.ci95 or None, {**details, DRAWING: number.drawing} if drawn else details)


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
        html = [f"<h3>{escape(self.title)}</h3><p>{escape(self.caption)}</p>"]
        for block in self.blocks:
            lines = [("", *block.columns), *((name, *texts) for name, texts in block.texts())]
            table = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in line)}</tr>" for line in lines)
            html.append(f"<h4>{escape(block.title)}</h4><table>{table}</table>")
        return "".join(html)


DIFFERENCES_NOTE = (
    "A row's number less another's, ± half the 95 % interval: 1.96 standard deviations over resamplings that draw the "
    "same takes for both rows. One is said to be better only where the interval leaves out 0; nothing corrects for how "
    "many pairs there are."
)
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
    differences: dict[tuple[RowId, RowId], dict[str, Number]] = {}
    for first, second in pairs_of((row for row in rows if row not in references), references):
        for name, column in column_of.items():
            if name in rows[first] and name in rows[second]:
                less = rows[first][name].less(rows[second][name])
                if less is not None:
                    differences.setdefault((first, second), {})[column] = less
    return differences


def of_interest(block: Block, differences: Differences, best: Iterable[str] = ()) -> Differences:
    """Select the informative differences between the rows of a block.

    These are with the best row of a column or a reference, or of two variants of a system. `best` names the best rows
    if the columns do not. If no row can be best, all are.
    """
    best = {*best} or {names[0] for names in _ranked(block).values()}
    shown = best | {row.name for row in block.rows if row.origin == "reference"}
    return {
        (first, second): by_column
        for (first, second), by_column in differences.items()
        if not best or shown & {str(first), str(second)} or first.system == second.system
    }


def differences_block(block: Block, differences: Differences) -> Block | None:
    """A row for each pair of a block's rows, with its verdict; None if there is no pair."""
    rows = []
    for (first, second), by_column in differences.items():
        cells = {column: Cell(each.value, each.ci95) for column, each in by_column.items()}
        rows += [Row(f"{first} − {second}", "ours", cells, verdicts(by_column, block.metrics))] if by_column else []
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
    ranked = {}
    for column in block.columns:
        better = _better_in(column, block.metrics)
        numbers = {
            row.name: row.cells[column].value for row in block.rows if row.origin == "ours" and column in row.cells
        }
        if better != "as real" and numbers:
            ranked[column] = sorted(numbers, key=lambda name: numbers[name], reverse=better == "higher")
    return ranked


def _better_in(column: str, metrics: Iterable[Measure]) -> str:
    """The direction of better numbers by the metric that names the column, or by the one that names none."""
    by_column = {measure.column: measure.better for measure in metrics}
    return by_column.get(column, by_column.get("", "as real"))


def verdicts(differences: Mapping[str, Number], metrics: tuple[Measure, ...]) -> str:
    """Columns in which the first row is better, worse, or no different; "lower" and "higher" if neither is better."""
    columns: dict[str, list[str]] = {}
    for column, each in differences.items():
        best = _better_in(column, metrics)
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
    best_rows = {}
    for column, (best, *others) in _ranked(block).items():
        tested = {
            other: cells[pair][column]
            for other in others
            for pair in (f"{best} − {other}", f"{other} − {best}")
            if column in cells.get(pair, {})
        }
        if tested:
            alike = (other for other, less in tested.items() if less.ci95 is not None and abs(less.value) <= less.ci95)
            best_rows[column] = frozenset([best, *alike])
    return best_rows


def environment() -> dict[str, Any]:
    """Versions, processors, time, the command, and the commit in a git checkout."""
    # Absolute paths are reduced to file names.
    words = [re.sub(r"(^|=)/(?:[^/]+/)*", r"\1", word) for word in sys.argv[1:]]
    return {
        "command": shlex.join([Path(sys.argv[0]).name, *words]),
        "versions": versions(),
        "processors": os.cpu_count(),
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "commit": commit(),
    }


def provenance(store: Path | None = None, runs: Iterable[Path] = ()) -> dict[str, Any]:
    """Provenance of figures: a store's fingerprint, the sha256 of the weights of every stage of some runs, environment.

    Raises `StoreError` for a missing store.
    """
    stages = {run: sorted(path.name for path in run.iterdir()) for run in runs}
    weights = {run.name: RunFolder(run).fingerprints(names) for run, names in stages.items()}
    of_store = {} if store is None else {"store": {"path": store.name, "fingerprint": read_manifest(store).fingerprint}}
    return {**of_store, "weights_sha256": weights, "environment": environment()}


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
        if (stated := document.pop("format", None)) != FORMAT:
            raise ValueError(f"not a result of format {FORMAT} (found {shown(stated)})")
        result = from_plain(Result, document)
    except (UsageError, OverflowError, TypeError, ValueError, OSError) as error:
        raise ResultError(f"{path}: cannot be read as a result: {error}; run the evaluation again") from None
    for name in (result.task, result.figure or result.task):
        if not _FILE_NAME.fullmatch(name):
            raise ResultError(f"{path}: {shown(name)} where a file's name was expected; run the evaluation again")
    return result


def find_results(folder: Path) -> tuple[list[Result], list[str]]:
    """Every result in a folder, and why others cannot be read; JSON files of another kind are left out."""
    results, faults = [], []
    for path in sorted(folder.glob("*.json")):
        try:
            if str(read_json(path, HINT).get("format")).startswith("motionkit-result/"):
                results.append(read_result(path))
        except (MotionkitError, OSError) as error:
            faults.append(describe(error))
    return results, faults


# What LaTeX's text mode reads as a command, or does not know.
LATEX = str.maketrans(
    {
        **{character: f"\\{character}" for character in "&%$#_{}"},
        **{"\\": r"\textbackslash{}", "^": r"\textasciicircum{}", "~": r"\textasciitilde{}", "–": "--"},
        **{"<": "$<$", ">": "$>$", "|": "$|$", "−": "$-$", "±": r"$\pm$", "×": r"$\times$", "÷": r"$\div$"},
        **{"≤": r"$\leq$", "≥": r"$\geq$", "∞": r"$\infty$", "↑": r"$\uparrow$", "↓": r"$\downarrow$"},
        **{"→": r"$\rightarrow$", "λ": r"$\lambda$", "μ": r"$\mu$", "σ": r"$\sigma$", "ζ": r"$\zeta$"},
        **{"θ": r"$\theta$", "Δ": r"$\Delta$", "²": "$^2$", "³": "$^3$", "…": r"\dots{}"},
    }
)


def samples_only(result: Result) -> Result:
    """The result without rows of a run's models: those of samples, real motion and papers; and what is said of them."""
    rows = [row for block in result.blocks for row in block.rows]
    references = {row.name for row in rows if row.origin != "ours"}
    folders = result.provenance.get("samples", {})
    samples = {*folders, *(name.rpartition("@")[0] for name in folders)}

    def is_kept(name: str) -> bool:
        systems = (name,) if name in references else name.split(" − ")
        return all(each in references or each.split(", ")[0] in samples for each in systems)

    blocks = (replace(block, rows=tuple(row for row in block.rows if is_kept(row.name))) for block in result.blocks)
    models = {row.name.split(", ")[0] for row in rows if not is_kept(row.name) and " − " not in row.name}

    def without_models(lines: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(line for line in lines if not line.startswith(tuple(models)))

    return replace(
        result,
        blocks=tuple(block for block in blocks if block.rows),
        missing=without_models(result.missing),
        notes=without_models(result.notes),
        figure="",
    )


def to_markdown(result: Result) -> str:
    """The whole result as Markdown."""
    texts = [f"# {result.title}", result.caption]
    texts += [f"![{result.title}]({result.figure})"] if result.figure else []
    for block in result.blocks:
        texts += [f"## {block.title}", _markdown_table(block.columns, block.texts())]
        measures = dict.fromkeys(map(format_measure, block.metrics))
        notes = [f"- {row.name}: {row.note}" for row in block.rows if row.note]
        texts += filter(None, [block.note, ". ".join(measures) + "." if measures else "", "\n".join(notes)])
        details = detail_tables(block)
        texts += ["<details><summary>Further metrics</summary>"] if details else []
        for table in details:
            numbers = [
                (row.name, [format_number(values[column]) if column in values else "–" for column in table["columns"]])
                for row, values in table["rows"]
            ]
            texts += [table["name"], _markdown_table(table["columns"], numbers)]
        texts += ["</details>"] if details else []
    for heading, lines in (("Not in this table:", result.missing), ("Notes:", result.notes)):
        texts += [heading, "\n".join(f"- {line}" for line in lines)] if lines else []
    return "\n\n".join([*texts, f"{result.task}, version {result.version}."]) + "\n"


def _markdown_table(columns: Sequence[str], rows: Iterable[tuple[str, Sequence[str]]]) -> str:
    def line(name: str, texts: Iterable[str]) -> str:
        return f"| {name} |{''.join(f' {text} |' for text in texts)}"

    head = [line("", (column.replace("|", "\\|") for column in columns)).replace("|  |", "| |", 1)]
    head.append("|---|" + "---|" * len(columns))
    return "\n".join([*head, *(line(name.replace("|", "\\|"), texts) for name, texts in rows)])


def to_latex(result: Result) -> str:
    """One LaTeX table per block (booktabs)."""
    lines = [f"% {_tex(result.title)} ({result.task}, version {result.version})"]
    for block in result.blocks:
        lines += [
            r"\begin{table}",
            rf"\caption{{{_tex(result.caption)} {_tex(block.title)}.}}",
            rf"\begin{{tabular}}{{l{'r' * len(block.columns)}}}",
            r"\toprule",
            rf" & {' & '.join(map(_tex, block.columns))} \\",
            r"\midrule",
            *(rf"{' & '.join(map(_tex, (name, *texts)))} \\" for name, texts in block.texts()),
            *(r"\bottomrule", r"\end{tabular}", r"\end{table}"),
        ]
    return "\n".join(lines) + "\n"


def _tex(text: str) -> str:
    return text.translate(LATEX)


def to_html(results: Sequence[Result], cards: Sequence[str] = (), figures: Mapping[int, "Figure"] = {}) -> str:
    """All results as one self-contained page.

    `cards` are articles, as HTML, in front; `figures` are placed in the results with these indices.
    """
    return render("report.html.j2", results=results, cards=cards, figures=figures)


def render(template: str, **values: Any) -> str:
    """A template of this folder as HTML: the page, or an article in front of its results."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("eval.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    filters: Mapping[str, Callable[..., object]] = {
        "cell": format_cell,
        "number": format_number,
        "details": detail_tables,
        "measure": format_measure,
        "best": best_in_column,
        "picture": picture,
        "origin": origin_line,
    }
    environment.filters.update(filters)
    return environment.get_template(template).render(values)


def picture(figure: "Figure") -> str:
    """A figure as PNG in a data URI."""
    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=110)
    return f"data:image/png;base64,{base64.b64encode(drawn.getvalue()).decode()}"


def origin_line(result: Result) -> str:
    """The command, commit and store that a result comes from, as far as known."""
    environment = result.provenance.get("environment", {})
    store = result.provenance.get("store", {}).get("fingerprint", "")
    facts = {
        "by": environment.get("command"),
        "at commit": (environment.get("commit") or "")[:12],
        "from the store with fingerprint": store[:12],
        "on": (environment.get("time") or "")[:10],
    }
    return ", ".join(f"{what} {value}" for what, value in facts.items() if value)


def to_csv(result: Result) -> str:
    """One line per number: block, row, origin, column, metric, value, half width of its 95 % interval."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("task", "version", "block", "row", "origin", "column", "metric", "value", "ci95"))
    for block in result.blocks:
        for row in block.rows:
            for column, cell in row.cells.items():
                place = (result.task, result.version, block.title, row.name, row.origin, column)
                writer.writerow((*place, "value", repr(cell.value), "" if cell.ci95 is None else repr(cell.ci95)))
                writer.writerows((*place, name, repr(value), "") for name, value in cell.details.items())
    return text.getvalue()


def format_measure(measure: Measure) -> str:
    """A metric's unit, direction, source and calibration in one line."""
    unit = f" in {measure.unit}" if measure.unit else ""
    better = "best as real motion has it" if measure.better == "as real" else f"{measure.better} is better"
    calibration = f"; calibration: {measure.calibration}" if measure.calibration else ""
    return f"{measure.title}{unit}: {better} ({measure.source}{calibration})"


def detail_tables(block: Block) -> list[dict[str, Any]]:
    """Each further metric of a block's own rows: its name, columns, and rows with their values by column."""
    own = [row for row in block.rows if row.origin != "paper"]
    tables = []
    for name in dict.fromkeys(name for row in own for cell in row.cells.values() for name in cell.details):
        every = (
            (row, {key: cell.details[name] for key, cell in row.cells.items() if name in cell.details}) for row in own
        )
        rows = [(row, values) for row, values in every if values]
        columns = [column for column in block.columns if any(column in values for _, values in rows)]
        tables.append({"name": name, "columns": columns, "rows": rows})
    return tables
