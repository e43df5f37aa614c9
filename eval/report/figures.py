"""Tables as curves over the framerate. No pyplot, no global state."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from motionkit.core.files import whole_file

# Maximum characters of a legend's line in two columns.
LABEL_WIDTH = 40
# Okabe and Ito's palette: distinguishable with any colour vision.
BLUE, VERMILLION, GREEN, ORANGE, SKY, PURPLE, GREY = (
    "#0072B2", "#D55E00", "#009E73", "#E69F00", "#56B4E9", "#CC79A7", "#5F5F5F",
)  # fmt: skip
CURVE_COLOURS = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, GREY)
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
FRAMERATE_LABEL = "framerate (frames per second)"


@dataclass(frozen=True)
class Curve:
    """One row of a table over a quantity: values and half-widths of their 95 % intervals (0 if there is none)."""

    label: str
    places: tuple[float, ...]
    values: tuple[float, ...]
    half_widths: tuple[float, ...]


@dataclass(frozen=True)
class Panel:
    """Comparable curves in one pair of axes; the axis of decibels need not include zero."""

    title: str
    y_label: str
    curves: tuple[Curve, ...]
    x_label: str = FRAMERATE_LABEL
    from_zero: bool = True


def curves_figure(panels: Sequence[Panel], width_inches: float = 12.0) -> Figure:
    """Panels of curves only, at most three per line."""
    columns = min(3, len(panels))
    lines = -(-len(panels) // columns)
    figure = Figure(figsize=(width_inches, 5.0 * lines), layout="constrained")
    places = figure.subplots(lines, columns, squeeze=False).ravel()
    for axes, panel in zip(places, panels, strict=False):
        draw_curves(axes, panel)
    for unused in places[len(panels) :]:
        unused.set_visible(False)
    return figure


def save(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG, SVG or PDF by its suffix, at 160 dots per inch; makes the folder."""
    with whole_file(path) as temporary:
        figure.savefig(temporary, dpi=160)
    return path


def draw_curves(axes: Axes, panel: Panel) -> None:
    """Draw curves with shaded intervals; the axis is logarithmic if the values span more than a decade."""
    curves = panel.curves
    for index, curve in enumerate(curves):
        places, values, widths = (np.array(column) for column in (curve.places, curve.values, curve.half_widths))
        colour, marker = CURVE_COLOURS[index % len(CURVE_COLOURS)], MARKERS[index % len(MARKERS)]
        # Colours repeat after six curves; the next six are dashed.
        style = "-" if index < len(CURVE_COLOURS) else "--"
        lines = axes.plot(places, values, style, color=colour, marker=marker, markersize=4.5, linewidth=1.6)
        lines[0].set_label(fill(curve.label, LABEL_WIDTH))
        low = np.maximum(values - widths, 1e-2 * values)
        axes.fill_between(places, low, values + widths, color=colour, alpha=0.18, linewidth=0)
    values = np.concatenate([np.array(curve.values) for curve in curves])
    if values.min() > 0.0 and values.max() > 10.0 * values.min():
        axes.set_yscale("log")
    elif panel.from_zero:
        axes.set_ylim(bottom=0.0)
    ticks = sorted({place for curve in curves for place in curve.places})
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_xlabel(panel.x_label, fontsize=9)
    axes.set_ylabel(panel.y_label, fontsize=9)
    axes.set_title(panel.title, fontsize=9.5, loc="left")
    axes.grid(axis="y", color="#E4E4E4", linewidth=0.7)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=8)
    axes.legend(fontsize=7.5, frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=2)
