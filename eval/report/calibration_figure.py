"""The calibration as a picture: a line of panels per feature set, a panel per kind of damage, a curve per framerate."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eval.clip_fid.calibration import DISJOINT, FLAT, MAX_FLAT_RATIO, level_name
from eval.corruptions import Family, families
from eval.report.figures import CURVE_COLOURS, GREY, MARKERS
from eval.report.results import Block, Cell, Result, ResultError, Row

PANEL_INCHES = (3.1, 3.3)


def calibration_figure(result: Result) -> Figure:
    """Scores of every level in multiples of the same-take floor, on a logarithmic axis, with 95 % intervals.

    The shaded band is where a harmless transform must stay, the dotted lines are the floors of disjoint takes (P2).
    Raises `ResultError` where the result is no calibration.
    """
    blocks = [block for block in result.blocks if block.provenance.get("shows") == "scores" and block.columns]
    if not blocks:
        raise ResultError(f"{result.title}: there is no calibration to draw in this result")
    kinds = families()
    width, height = PANEL_INCHES
    size = (width * (len(kinds) + 1), height * len(blocks) + 0.7)
    figure = Figure(figsize=size, layout="constrained")
    grid = figure.subplots(len(blocks), len(kinds) + 1, squeeze=False, sharey="row")
    for line, block in zip(grid, blocks, strict=True):
        rows = {row.name: row for row in block.rows}
        _draw_flat(line[0], block, [row for row in block.rows if row.name.startswith(FLAT)])
        for axes, family in zip(line[1:], kinds, strict=True):
            _draw_family(axes, block, rows, family)
        for axes in line:
            _finish(axes, block, rows)
        line[0].set_ylabel(f"{block.provenance['features']}\nmultiples of the same-take floor", fontsize=9)
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
    """A family's levels from mild to severe; a level that is no damage at a framerate is left out of its curve."""
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
