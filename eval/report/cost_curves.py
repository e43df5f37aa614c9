"""A result that sets seconds against quality (NeRM's Figure 8), as a curve over the seconds."""

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from eval.report.figures import BLUE, GREY
from eval.report.results import Block, Result, Row


@dataclass(frozen=True)
class CostCurve:
    """Points (seconds, value ± half-width) with a label each, and levels that cost nothing: (label, value)."""

    title: str
    x_label: str
    y_label: str
    labels: tuple[str, ...]
    seconds: tuple[float, ...]
    values: tuple[float, ...]
    half_widths: tuple[float, ...]
    levels: tuple[tuple[str, float], ...]


def cost_curve_of(result: Result) -> CostCurve | None:
    """The first block whose columns begin with seconds and end with a quality; None where there is no such block."""
    for block in result.blocks:
        points = _points(block)
        if points and "seconds" in block.columns[0]:
            seconds, quality = block.columns[0], block.columns[-1]
            cells = [row.cells[quality] for row in points]
            return CostCurve(
                title=result.title,
                x_label=seconds,
                y_label=f"{quality} ({'lower' if block.lower_is_better else 'higher'} is better)",
                labels=tuple(row.name for row in points),
                seconds=tuple(row.cells[seconds].value for row in points),
                values=tuple(cell.value for cell in cells),
                half_widths=tuple(cell.ci95 or 0.0 for cell in cells),
                levels=tuple(
                    (row.name, row.cells[quality].value)
                    for row in block.rows
                    if row not in points and quality in row.cells
                ),
            )
    return None


def cost_figure(curve: CostCurve, width_inches: float = 6.4) -> Figure:
    """Both axes begin at zero, so that distances are what they are; levels are dashed lines."""
    figure = Figure(figsize=(width_inches, 0.65 * width_inches), layout="constrained")
    axes = figure.subplots()
    axes.errorbar(curve.seconds, curve.values, curve.half_widths, color=BLUE, marker="o", markersize=4.5, capsize=2.0)
    for label, x, y in zip(curve.labels, curve.seconds, curve.values, strict=True):
        axes.annotate(label, (x, y), xytext=(0, -6), textcoords="offset points", fontsize=7.5, rotation=-40, va="top")
    for label, level in curve.levels:
        axes.axhline(level, color=GREY, linewidth=0.8, linestyle="--")
        axes.annotate(label, (0.0, level), xytext=(4, 2), textcoords="offset points", fontsize=7.5, color=GREY)
    axes.set_xlim(0.0, 1.35 * max(curve.seconds))
    axes.set_ylim(0.0, 1.15 * max((*curve.values, *(level for _, level in curve.levels))))
    axes.set_xlabel(curve.x_label, fontsize=9)
    axes.set_ylabel(curve.y_label, fontsize=9)
    axes.set_title(curve.title, fontsize=9.5, loc="left")
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=8)
    return figure


def _points(block: Block) -> Sequence[Row]:
    """Rows that have both seconds and a quality."""
    return [row for row in block.rows if block.columns[0] in row.cells and block.columns[-1] in row.cells]
