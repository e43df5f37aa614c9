"""Markdown, LaTeX, CSV and HTML from results; nothing is computed here."""

import base64
import csv
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from eval.report.results import Block, Measure, Result, best_in_column, format_cell, format_number

if TYPE_CHECKING:
    from jinja2 import Environment
    from matplotlib.figure import Figure

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


def to_markdown(result: Result) -> str:
    """The whole result as Markdown."""
    found = [f"# {result.title}", result.caption]
    found += [f"![{result.title}]({result.figure})"] if result.figure else []
    for block in result.blocks:
        found += [f"## {block.title}", _markdown_table(block.columns, block.texts())]
        measures = dict.fromkeys(map(format_measure, block.metrics))
        notes = [f"- {row.name}: {row.note}" for row in block.rows if row.note]
        found += filter(None, [block.note, ". ".join(measures) + "." if measures else "", "\n".join(notes)])
        details = detail_tables(block)
        found += ["<details><summary>Further metrics</summary>"] if details else []
        for table in details:
            numbers = [
                (row.name, [format_number(values[column]) if column in values else "–" for column in table["columns"]])
                for row, values in table["rows"]
            ]
            found += [table["name"], _markdown_table(table["columns"], numbers)]
        found += ["</details>"] if details else []
    for heading, lines in (("Not in this table:", result.missing), ("Notes:", result.notes)):
        found += [heading, "\n".join(f"- {line}" for line in lines)] if lines else []
    return "\n\n".join([*found, f"{result.task}, version {result.version}."]) + "\n"


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


def to_html(
    results: Sequence[Result],
    title: str = "motionkit results",
    cards: Sequence[str] = (),
    figures: Mapping[int, "Figure"] = {},
) -> str:
    """All results as one self-contained page.

    `cards` are articles, as HTML, in front; `figures` are placed in the results with these indices.
    """
    page = _environment().get_template("report.html.j2")
    return page.render(results=results, title=title, cards=cards, figures=figures)


def card(template: str, **values: Any) -> str:
    """An article in front of a page's results, from a template of this folder."""
    return _environment().get_template(template).render(values)


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


def _environment() -> "Environment":
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
    return environment
