"""Results as curves: seconds against quality, columns of a table over the framerate, calibrations."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eval.calibration import DISJOINT, FLAT, MAX_FLAT_RATIO, TASK, level_name
from eval.report.figures import BLUE, CURVE_COLOURS, FRAMERATE_LABEL, GREY, MARKERS, Curve, Panel, curves_figure
from eval.report.results import Block, Cell, Result, ResultError, Row
from eval.sets.corruptions import Family, damages


def cost_figure(result: Result, width_inches: float = 6.4) -> Figure | None:
    """The first block whose columns begin with seconds and end with a quality; None if there is no such block.

    Rows with both are points, others levels (dashed). Both axes begin at zero, so that distances are to scale.
    """
    found = [block for block in result.blocks if block.columns and "seconds" in block.columns[0]]
    block = next((block for block in found if any(block.columns[0] in row.cells for row in block.rows)), None)
    if block is None:
        return None
    seconds, quality = block.columns[0], block.columns[-1]
    points = [row for row in block.rows if seconds in row.cells and quality in row.cells]
    levels = [row for row in block.rows if row not in points and quality in row.cells]
    x = [row.cells[seconds].value for row in points]
    y = [row.cells[quality].value for row in points]
    half_widths = [row.cells[quality].ci95 or 0.0 for row in points]
    figure = Figure(figsize=(width_inches, 0.65 * width_inches), layout="constrained")
    axes = figure.subplots()
    axes.errorbar(x, y, half_widths, color=BLUE, marker="o", markersize=4.5, capsize=2.0)
    small: dict[str, Any] = {"textcoords": "offset points", "fontsize": 7.5}
    for row, place in zip(points, zip(x, y, strict=True), strict=True):
        axes.annotate(row.name, place, xytext=(0, -6), rotation=-40, va="top", **small)
    for row in levels:
        level = row.cells[quality].value
        axes.axhline(level, color=GREY, linewidth=0.8, linestyle="--")
        axes.annotate(row.name, (0.0, level), xytext=(4, 2), color=GREY, **small)
    tops = map(sum, zip(y, half_widths, strict=True))
    axes.set_xlim(0.0, 1.35 * max(x))
    axes.set_ylim(0.0, 1.05 * max((*tops, *(row.cells[quality].value for row in levels))))
    axes.set_xlabel(seconds, fontsize=9)
    axes.set_ylabel(f"{quality} ({'lower' if block.lower_is_better else 'higher'} is better)", fontsize=9)
    axes.set_title(result.title, fontsize=9.5, loc="left")
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=8)
    return figure


# "120 fps", "×2.4", "15 frames", "λ = 0.5": prefix, number, unit.
COLUMN = re.compile(r"(?P<before>×|\w+ = |)(?P<number>\d+(?:\.\d+)?)(?P<after> fps| frames|)")
X_LABELS = {("", " fps"): FRAMERATE_LABEL, ("", " frames"): "frames asked for", ("×", ""): "scale"}


def panels_of(result: Result, y_label: str = "lower is better") -> tuple[Panel, ...]:
    """One panel per block, since numbers of different blocks are not comparable; ours first, then the paper's.

    `y_label` is that of the blocks in which lower is better; others have none. Blocks whose columns are not all values
    of one quantity ("120 fps", "×4", "30 frames", "λ = 0.5") are left out, and so are differences between rows.
    """
    scores = [block for block in result.blocks if not block.differences_of]
    ordered = sorted(filter(_quantity, scores), key=_is_from_paper)
    panels = (
        Panel(
            block.title,
            y_label if block.lower_is_better else "",
            _curves(block),
            _quantity(block) or "",
            from_zero=block.lower_is_better,
        )
        for block in ordered
    )
    return tuple(panel for panel in panels if panel.curves)


def _quantity(block: Block) -> str | None:
    """The axis label of the columns' quantity; None if they are not of one quantity."""
    found = [COLUMN.fullmatch(column) for column in block.columns]
    kinds = {None if match is None else (match["before"], match["after"]) for match in found}
    kind = kinds.pop() if len(kinds) == 1 else None
    if kind is None or kind == ("", ""):
        return None
    return X_LABELS.get(kind) or kind[0].removesuffix(" = ")


def _is_from_paper(block: Block) -> bool:
    return all(row.origin == "paper" for row in block.rows)


def _curves(block: Block) -> tuple[Curve, ...]:
    return tuple(_curve(row, block.columns) for row in block.rows if row.cells)


def _curve(row: Row, columns: tuple[str, ...]) -> Curve:
    present = [column for column in columns if column in row.cells]
    cells = [row.cells[column] for column in present]
    return Curve(
        label=row.name.removesuffix(" (paper)"),
        places=tuple(_number(column) for column in present),
        values=tuple(cell.value for cell in cells),
        half_widths=tuple(cell.ci95 or 0.0 for cell in cells),
    )


def _number(column: str) -> float:
    match = COLUMN.fullmatch(column)
    assert match is not None
    return float(match["number"])


def figure_of(result: Result) -> Figure | None:
    """A calibration, or a table over framerates or over seconds and a quality, drawn; None for any other."""
    panels = panels_of(result)
    if result.task == TASK:
        return calibration_figure(result)
    if panels:
        return curves_figure(panels)
    return cost_figure(result)


PANEL_INCHES, PANELS_A_LINE = (3.1, 3.0), 3


def calibration_figure(result: Result) -> Figure:
    """Scores of every level in multiples of the same-take floor, on a logarithmic axis, with 95 % intervals.

    The shaded band is where a harmless transform must stay, the dotted lines are the floors of disjoint takes (P2).
    Raises `ResultError` if the result is not a calibration.
    """
    blocks = [block for block in result.blocks if block.provenance.get("shows") == "scores" and block.columns]
    if not blocks:
        raise ResultError(f"{result.title}: there is no calibration to draw in this result")
    kinds = damages()
    width, height = PANEL_INCHES
    lines = -(-(len(kinds) + 1) // PANELS_A_LINE)
    size = (width * PANELS_A_LINE, height * lines * len(blocks) + 0.7)
    figure = Figure(figsize=size, layout="constrained")
    grid = figure.subplots(lines * len(blocks), PANELS_A_LINE, squeeze=False, sharey=True)
    for number, block in enumerate(blocks):
        rows = {row.name: row for row in block.rows}
        places = grid[number * lines : (number + 1) * lines].ravel()
        _draw_flat(places[0], block, [row for row in block.rows if row.name.startswith(FLAT)])
        for axes, family in zip(places[1:], kinds, strict=False):
            _draw_family(axes, block, rows, family)
        for axes in places[: len(kinds) + 1]:
            _finish(axes, block, rows)
        for axes in places[len(kinds) + 1 :]:
            axes.set_visible(False)
        places[0].set_ylabel(f"{block.provenance['features']}\nmultiples of the same-take floor", fontsize=9)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), fontsize=9, frameon=False)
    return figure


def _draw_flat(axes: Axes, block: Block, rows: Sequence[Row]) -> None:
    for index, column in enumerate(block.columns):
        _draw_curve(axes, index, column, [row.cells.get(column) for row in rows], line="")
    labels = [row.name.removeprefix(FLAT) for row in rows]
    axes.set_xticks(range(len(rows)), [_wrapped(label) for label in labels], fontsize=6.5, rotation=35, ha="right")
    axes.set_title("harmless", fontsize=10, loc="left")


def _draw_family(axes: Axes, block: Block, rows: dict[str, Row], family: Family) -> None:
    """A family's levels from mild to severe; levels without damage at a framerate are left out of its curve."""
    for index, column in enumerate(block.columns):
        found = [rows.get(level_name(family, level)) for level in family.levels]
        _draw_curve(axes, index, column, [row.cells.get(column) if row else None for row in found], line="-")
    axes.set_xticks(range(len(family.levels)), [f"{level:g}" for level in family.levels], fontsize=8)
    axes.set_xlabel(family.unit, fontsize=8.5)
    axes.set_title(family.name, fontsize=10, loc="left")


def _draw_curve(axes: Axes, index: int, column: str, cells: Sequence[Cell | None], line: str) -> None:
    present = [(place, cell) for place, cell in enumerate(cells) if cell is not None]
    if not present:
        return
    places = np.array([place for place, _ in present], dtype=np.float64)
    values = np.array([cell.value for _, cell in present])
    widths = np.array([cell.ci95 or 0.0 for _, cell in present])
    colour, marker = CURVE_COLOURS[index % len(CURVE_COLOURS)], MARKERS[index % len(MARKERS)]
    below = np.minimum(widths, 0.99 * values)
    axes.errorbar(
        places, values, yerr=np.stack((below, widths)), fmt=f"{line}{marker}", color=colour, label=column,
        markersize=4, linewidth=1.4, elinewidth=1.0, capsize=2,
    )  # fmt: skip


def _finish(axes: Axes, block: Block, rows: dict[str, Row]) -> None:
    axes.set_yscale("log")
    axes.axhspan(1.0 / MAX_FLAT_RATIO, MAX_FLAT_RATIO, color=GREY, alpha=0.15, linewidth=0)
    for index, column in enumerate(block.columns):
        cell = rows[DISJOINT].cells.get(column) if DISJOINT in rows else None
        if cell is not None:
            axes.axhline(cell.value, color=CURVE_COLOURS[index % len(CURVE_COLOURS)], linestyle=":", linewidth=0.9)
    axes.grid(axis="y", color="#E4E4E4", linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(axis="y", labelsize=8)


def _wrapped(label: str, width: int = 20) -> str:
    import textwrap

    return "\n".join(textwrap.wrap(label, width))
