"""Figures: strips of skeletons over time, and tables as curves over the framerate. No pyplot, no global state."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from motionkit.core.files import whole_file
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32, Float64
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.skeletons.mapping import map_joints

# Maximum characters of a legend's line in two columns.
LABEL_WIDTH = 40
# Okabe and Ito's palette: distinguishable with any colour vision.
BLUE, VERMILLION, GREEN, ORANGE, SKY, PURPLE, GREY = (
    "#0072B2", "#D55E00", "#009E73", "#E69F00", "#56B4E9", "#CC79A7", "#5F5F5F",
)  # fmt: skip
CURVE_COLOURS = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, GREY)
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
SIDE_COLOURS = {"left": BLUE, "right": VERMILLION, "middle": "#303030"}
# The camera is to the front right of the first pose, so that a walk goes to the right of the picture.
CAMERA_YAW = np.deg2rad(118.0)
CAMERA_PITCH = np.deg2rad(8.0)
SLOT_METRES = 0.95
FRAMERATE_LABEL = "framerate (frames per second)"


@dataclass(frozen=True, eq=False)
class Strip:
    """One row of a figure: poses [K, J, 3] in metres at times in seconds, and its title."""

    title: str
    joint_positions: Float32[np.ndarray, "poses joints 3"]
    seconds: Float64[np.ndarray, " poses"]
    skeleton: Skeleton


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


def strip_of(motion: Motion, title: str, num_poses: int = 10, seconds: float | None = None) -> Strip:
    """Frames of a motion, about evenly spaced over its first `seconds` (all of it by default).

    They are drawn in the 22-joint layout. Raises `SkeletonMapError` if the skeleton cannot be mapped to it.
    """
    span = motion.timegrid.span_seconds if seconds is None else min(seconds, motion.timegrid.span_seconds)
    frames = np.round(np.linspace(0.0, span, num_poses) * float(motion.fps)).astype(int)
    return Strip(title, map_joints(motion, "smpl22")[frames], motion.timegrid.seconds()[frames], SMPL22)


def curves_and_strips_figure(panels: Sequence[Panel], strips: Sequence[Strip], width_inches: float = 10.0) -> Figure:
    """Curves above, each with its own scale; below them strips of skeletons, left limbs blue, right ones vermillion."""
    heights = (4.0, 1.55 * max(1, len(strips)))
    figure = Figure(figsize=(width_inches, sum(heights)), layout="constrained")
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=heights).ravel()
    for axes, panel in zip(np.atleast_1d(above.subplots(1, len(panels))), panels, strict=True):
        draw_curves(axes, panel)
    if strips:
        for axes, strip in zip(np.atleast_1d(below.subplots(len(strips), 1)), strips, strict=True):
            draw_strip(axes, strip)
    return figure


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


def draw_strip(axes: Axes, strip: Strip) -> None:
    """Draw one strip: every pose in a slot of its own over its time, with the floor under it."""
    segments, colours = strip_segments(strip)
    axes.add_collection(LineCollection(list(segments), colors=colours, linewidths=1.6, capstyle="round"))
    places = np.arange(len(strip.seconds)) * SLOT_METRES
    floor = min(0.0, float(segments[..., 1].min()))
    axes.axhline(floor, color="#C8C8C8", linewidth=0.8, zorder=0)
    # A reach or a fall may leave the slot; the limits follow the drawing.
    left, right = float(segments[..., 0].min()), float(segments[..., 0].max())
    axes.set_xlim(min(left, -0.5 * SLOT_METRES), max(right, places[-1] + 0.5 * SLOT_METRES))
    axes.set_ylim(floor - 0.05, max(1.75, float(segments[..., 1].max()) + 0.05))
    axes.set_aspect("equal")
    axes.set_xticks(places, [f"{second:.1f} s" for second in strip.seconds], fontsize=7, color=GREY)
    axes.tick_params(axis="x", length=0, pad=2)
    axes.set_yticks([])
    axes.spines[:].set_visible(False)
    axes.set_title(strip.title, fontsize=8, loc="left", pad=2)


def strip_segments(strip: Strip) -> tuple[Float64[np.ndarray, "lines 2 2"], list[str]]:
    """Lines from parent to child joint on the picture plane in metres, far ones first, and their colours."""
    positions = strip.joint_positions.astype(np.float64)
    positions[..., [0, 2]] -= positions[:, :1, [0, 2]]
    yaw = _heading(positions[0], strip.skeleton) + CAMERA_YAW
    right = np.array([-np.cos(yaw), 0.0, np.sin(yaw)])
    away = np.array([np.sin(yaw), 0.0, np.cos(yaw)])
    depth = positions @ away
    across = positions @ right + np.arange(len(positions))[:, None] * SLOT_METRES
    up = positions[..., 1] * np.cos(CAMERA_PITCH) + depth * np.sin(CAMERA_PITCH)
    plane = np.stack((across, up), axis=-1)
    children = np.arange(1, strip.skeleton.num_joints)
    parents = np.array(strip.skeleton.parents[1:])
    lines = np.stack((plane[:, parents], plane[:, children]), axis=2)
    order = np.argsort(-(depth[:, parents] + depth[:, children]), axis=1, kind="stable")
    sides = np.array([SIDE_COLOURS[side] for side in _sides(strip.skeleton)])[children]
    ordered = np.take_along_axis(lines, order[:, :, None, None], axis=1)
    return ordered.reshape(-1, 2, 2), sides[order].ravel().tolist()


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


def _heading(pose: Float64[np.ndarray, "joints 3"], skeleton: Skeleton) -> float:
    """Yaw of a pose from the first left-right pair of joints, the hips of the standard skeletons; 0 faces +Z."""
    if not skeleton.left_right_pairs:
        return 0.0
    left, right = skeleton.left_right_pairs[0]
    across = pose[left] - pose[right]
    return float(np.arctan2(-across[2], across[0]))


def _sides(skeleton: Skeleton) -> list[str]:
    sides = ["middle"] * skeleton.num_joints
    for left, right in skeleton.left_right_pairs:
        sides[left], sides[right] = "left", "right"
    return sides
