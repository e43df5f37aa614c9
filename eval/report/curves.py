"""Results as curves: seconds against quality, columns of a table over the framerate."""

import re
from typing import Any

from matplotlib.figure import Figure

from eval.report.figures import BLUE, FRAMERATE_LABEL, GREY, Curve, Panel, curves_figure
from eval.report.results import Block, Result, Row


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
    """A table over framerates, or over seconds and a quality, drawn; None for any other."""
    panels = panels_of(result)
    return curves_figure(panels) if panels else cost_figure(result)
