"""Curves of tables over the framerate, of seconds against quality, and of a run's training. No pyplot."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from matplotlib.text import Annotation
from scipy.optimize import isotonic_regression

from eval.report.results import Block, Result, render
from motionkit.core.files import whole_file
from motionkit.training.run import RunError, RunFolder

# Okabe and Ito's palette, distinguishable with any colour vision (blue, sky, green, purple, orange, vermillion, grey,
# black), then Tol's indigo, wine, olive and teal.
OKABE_ITO = ("#0072B2", "#56B4E9", "#009E73", "#CC79A7", "#E69F00", "#D55E00", "#7F7F7F", "#000000")
CURVE_COLOURS = (*OKABE_ITO, "#332288", "#882255", "#999933", "#44AA99")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
FRAMERATE_LABEL = "framerate (frames per second)"
# "120 fps", "×2.4", "15 frames", "λ = 0.5": prefix, number, unit.
COLUMN = re.compile(r"(?P<before>×|\w+ = |)(?P<number>\d+(?:\.\d+)?)(?P<after> fps| frames|)")
X_LABELS = {("", " fps"): FRAMERATE_LABEL, ("", " frames"): "number of frames", ("×", ""): "scale"}


@dataclass(frozen=True)
class Curve:
    """One row of a table over a quantity: values and half-widths of their 95 % intervals (0 if there is none)."""

    label: str
    places: tuple[float, ...]
    values: tuple[float, ...]
    half_widths: tuple[float, ...]


@dataclass(frozen=True)
class Panel:
    """Comparable curves in one pair of axes; the axis of decibels need not include zero.

    Losses over the steps of a training are lines without markers on a logarithmic axis.
    """

    title: str
    y_label: str
    curves: tuple[Curve, ...]
    x_label: str = FRAMERATE_LABEL
    from_zero: bool = True
    is_training: bool = False


def curves_figure(panels: Sequence[Panel]) -> Figure:
    """Panels of curves only, at most two per line."""
    lines = -(-len(panels) // 2)
    height_inches = max(4.2, 1.2 + 0.27 * max(len(panel.curves) for panel in panels))
    figure = Figure(figsize=(12.0, height_inches * lines), layout="constrained")
    draw_panels(figure, panels)
    return figure


def draw_panels(figure: FigureBase, panels: Sequence[Panel]) -> None:
    """Draw panels of curves, at most two per line, each curve with its name at its end."""
    columns = min(2, len(panels))
    places = np.ravel(figure.subplots(-(-len(panels) // columns), columns, squeeze=False))
    names = [
        _draw(axes, panel, colours) for axes, panel, colours in zip(places, panels, row_colours(panels), strict=False)
    ]
    for unused in places[len(panels) :]:
        unused.set_visible(False)
    figure.figure.draw_without_rendering()  # type: ignore[union-attr]
    for axes, annotations in zip(places, names, strict=False):
        _spread(axes, annotations)


def row_colours(panels: Sequence[Panel]) -> list[dict[str, str]]:
    """Each panel's colours by its rows' names: a row of one name, or of one system, has one colour in all panels."""
    numbers: dict[str, int] = {}
    colours = []
    for panel in panels:
        keys: dict[str, str] = {}
        for curve in panel.curves:
            # Of a system's several rows the first stands for it: "NeRM, local latents (ours)" for "NeRM".
            system = re.split(r"[,(]", curve.label)[0].strip()
            keys[curve.label] = curve.label if system in keys.values() else system
        for key in keys.values():
            numbers.setdefault(key, len(numbers))
        colours.append({label: CURVE_COLOURS[numbers[key] % len(CURVE_COLOURS)] for label, key in keys.items()})
    return colours


def save(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG, SVG or PDF by its suffix, at 160 dots per inch; makes the folder."""
    with whole_file(path) as temporary:
        figure.savefig(temporary, dpi=160)
    return path


def _draw(axes: Axes, panel: Panel, colours: Mapping[str, str]) -> list[Annotation]:
    """Draw curves with their intervals; the axis is logarithmic if the values span more than a decade.

    Returns each curve's name, at the height of its end.
    """
    every = np.concatenate([np.array(curve.values) for curve in panel.curves])
    ticks = sorted({place for curve in panel.curves for place in curve.places})
    logarithmic = panel.is_training or (every.min() > 0.0 and every.max() > 10.0 * every.min())
    drawn: list[Curve] = []
    names = []
    for index, curve in enumerate(panel.curves):
        places, values, widths = (np.array(column) for column in (curve.places, curve.values, curve.half_widths))
        colour = colours[curve.label]
        # Dashes show the curve below one that is the same to a few per cent, and are another style for a used colour.
        hides = any(each.places == curve.places and np.allclose(each.values, values, 0.08) for each in drawn)
        style = (0, (4, 3)) if hides or colour in {colours[each.label] for each in drawn} else "-"
        axes.plot(places, values, linestyle=style, color=colour, linewidth=1.8, label=curve.label)
        drawn.append(curve)
        if not panel.is_training:
            axes.plot(places, values, MARKERS[index % len(MARKERS)], color=colour, markersize=4.5)
            beside = places + (index - len(panel.curves) / 2) * 0.006 * (ticks[-1] - ticks[0])
            axes.errorbar(beside, values, widths, fmt="none", ecolor=colour, elinewidth=0.8, alpha=0.5)
        at_end: dict[str, Any] = {"xy": (places[-1], values[-1]), "xytext": (1.04, 0.5), "textcoords": "axes fraction"}
        line = {"arrowstyle": "-", "color": colour, "linewidth": 0.6, "shrinkA": 1.0, "relpos": (0.0, 0.5)}
        text = fill(curve.label, 28)
        names.append(axes.annotate(text, **at_end, arrowprops=line, color=colour, fontsize=8, va="center"))
    if logarithmic:
        axes.set_yscale("log")
        # An interval down to zero ends at the axis.
        axes.set_ylim(0.7 * every[every > 0.0].min(), 1.4 * every.max())
    elif panel.from_zero:
        axes.set_ylim(bottom=0.0)
    if not panel.is_training:
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    _label(axes, panel.title, panel.x_label, panel.y_label)
    axes.grid(axis="y", color="#E4E4E4", linewidth=0.7)
    return names


def _spread(axes: Axes, names: Sequence[Annotation]) -> None:
    """Move names as little as they need not to overlap, from lowest to highest end, and into the axes if they fit."""
    line = 11.5 * axes.figure.dpi / 72.0 / axes.bbox.height
    heights = {name: float(axes.transAxes.inverted().transform(axes.transData.transform(name.xy))[1]) for name in names}
    ordered = sorted(names, key=lambda name: heights[name])
    sizes = np.array([line * (1.2 + name.get_text().count("\n")) for name in ordered])
    middles = np.cumsum(sizes) - sizes / 2
    # The distances from the nearest places without overlaps: the least squares of a sequence that must not fall.
    shifts = isotonic_regression(np.array([heights[name] for name in ordered]) - middles).x
    shifts = np.clip(shifts, 0.0, max(0.0, 1.0 - sizes.sum()))
    for name, middle in zip(ordered, middles + shifts, strict=True):
        name.set_position((1.04, middle))


def _label(axes: Axes, title: str, x_label: str, y_label: str) -> None:
    axes.set_title(fill(title, 56), fontsize=9.5, loc="left")
    axes.set_xlabel(x_label, fontsize=9)
    axes.set_ylabel(y_label, fontsize=9)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=8, which="both")


def figure_of(result: Result) -> Figure | None:
    """A table over framerates, or over seconds and a quality, drawn; None for any other."""
    panels = panels_of(result)
    return curves_figure(panels) if panels else cost_figure(result)


def panels_of(result: Result, y_label: str = "lower is better") -> tuple[Panel, ...]:
    """One panel per block, since numbers of different blocks are not comparable; ours first, then the paper's.

    `y_label` is that of the blocks in which lower is better; others have none. Blocks whose columns are not all values
    of one quantity ("120 fps", "×4", "30 frames", "λ = 0.5") are left out, and so are differences between rows.
    """
    panels = []
    for block in sorted(result.blocks, key=lambda block: all(row.origin == "paper" for row in block.rows)):
        quantity, curves = _quantity(block), _curves(block)
        if quantity is not None and curves and not block.differences_of:
            label = y_label if block.lower_is_better else ""
            panels.append(Panel(block.title, label, curves, quantity, from_zero=block.lower_is_better))
    return tuple(panels)


def _quantity(block: Block) -> str | None:
    """The axis label of the columns' quantity; None if they are not of one quantity."""
    matches = [COLUMN.fullmatch(column) for column in block.columns]
    kinds = {None if match is None else (match["before"], match["after"]) for match in matches}
    kind = kinds.pop() if len(kinds) == 1 else None
    if kind is None or kind == ("", ""):
        return None
    return X_LABELS.get(kind) or kind[0].removesuffix(" = ")


def _curves(block: Block) -> tuple[Curve, ...]:
    places = {column: float(match["number"]) for column in block.columns if (match := COLUMN.fullmatch(column))}
    curves = []
    for row in block.rows:
        points = [(place, row.cells[column]) for column, place in places.items() if column in row.cells]
        if points:
            values, widths = tuple(cell.value for _, cell in points), tuple(cell.ci95 or 0.0 for _, cell in points)
            label = row.name.removesuffix(" (paper)")
            curves.append(Curve(label, tuple(place for place, _ in points), values, widths))
    return tuple(curves)


def cost_figure(result: Result) -> Figure | None:
    """The first block whose columns begin with seconds and end with a quality; None if there is no such block.

    Rows with both are points, others levels (dashed). Both axes begin at zero, so that distances are to scale.
    """
    timed = [block for block in result.blocks if block.columns and "seconds" in block.columns[0]]
    block = next((block for block in timed if any(block.columns[0] in row.cells for row in block.rows)), None)
    if block is None:
        return None
    seconds, quality = block.columns[0], block.columns[-1]
    rows = {row.name: row.cells for row in block.rows if quality in row.cells}
    points = {name: cells for name, cells in rows.items() if seconds in cells}
    x, y = ([cells[column].value for cells in points.values()] for column in (seconds, quality))
    half_widths = [cells[quality].ci95 or 0.0 for cells in points.values()]
    figure = Figure(figsize=(6.4, 4.16), layout="constrained")
    axes = figure.subplots()
    axes.errorbar(x, y, half_widths, color=CURVE_COLOURS[0], marker="o", markersize=4.5, capsize=2.0)
    small: dict[str, Any] = {"textcoords": "offset points", "fontsize": 7.5}
    grey = CURVE_COLOURS[6]
    for name, cells in rows.items():
        level = cells[quality].value
        if name in points:
            axes.annotate(name, (cells[seconds].value, level), xytext=(0, -6), rotation=-40, va="top", **small)
        else:
            axes.axhline(level, color=grey, linewidth=0.8, linestyle="--")
            axes.annotate(name, (0.0, level), xytext=(4, 2), color=grey, **small)
    tops = map(sum, zip(y, half_widths, strict=True))
    axes.set_xlim(0.0, 1.35 * max(x))
    axes.set_ylim(0.0, 1.05 * max((*tops, *(cells[quality].value for cells in rows.values()))))
    better = "lower" if block.lower_is_better else "higher"
    _label(axes, result.title, seconds, f"{quality} ({better} is better)")
    return figure


@dataclass(frozen=True)
class StageTraining:
    """One stage of a run: facts for people, in order, and its logged steps, oldest first."""

    name: str
    facts: Mapping[str, str]
    lines: Sequence[Mapping[str, float]]


def stages_of(run: Path) -> list[StageTraining]:
    """Every stage of a run, by name.

    Raises `RunError` for a folder without stages, `DamagedFileError` for damaged files.
    """
    folders = sorted(path for path in run.glob("*") if (path / "config.json").is_file())
    if not folders:
        raise RunError(f"{run} holds no trained stage (motionkit train --run {run.name})")
    weights = RunFolder(run).fingerprints()
    stages = []
    for path in folders:
        stage = RunFolder(run).stage(path.name)
        config = stage.read_config()
        facts = {
            "recipe": str(config.get("recipe", "–")),
            "steps": "–" if stage.is_complete else "not finished",
            "parameters": "–",
            "processor time": "–",
            **stage.effort(),
            "commit": str(config.get("commit") or "–")[:12],
            "store": str(config.get("store_fingerprint", "–"))[:12],
            "weights (sha256)": weights.get(path.name, "–")[:12],
        }
        stages.append(StageTraining(path.name, facts, stage.read_metrics()))
    return stages


def training_figure(stages: Sequence[StageTraining]) -> Figure | None:
    """Logged values of each stage over its steps, on logarithmic axes; None if there are none."""
    panels = []
    for stage in stages:
        curves = []
        for name in dict.fromkeys(key for line in stage.lines for key in line if key not in ("step", "seconds")):
            by_step = {line["step"]: line[name] for line in stage.lines if line.get(name, 0.0) > 0}
            if by_step:
                curves.append(Curve(name, tuple(by_step), tuple(by_step.values()), (0.0,) * len(by_step)))
        if curves:
            panels.append(Panel(stage.name, "", tuple(curves), "steps", is_training=True))
    return curves_figure(panels) if panels else None


def run_card(run: Path, motions: Sequence[tuple[str, str]] = ()) -> str:
    """An article about a run for the report's page; `motions` are titles and pages of animated skeletons.

    Raises as `stages_of`.
    """
    stages = stages_of(run)
    return render("run.html.j2", name=run.name, stages=stages, figure=training_figure(stages), motions=motions)
