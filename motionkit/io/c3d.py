"""C3D markers: points of a capture without bones, at the point rate, in metres and y up.

A motion of markers has the first marker as its root and all others as the root's children, with offsets of zero: a
skeleton that only names them. A `--skeleton-map` computes the 22 joints from them. Source: "The C3D File Format User
Guide", Motion Lab Systems 2021, https://www.c3d.org (units, screen axes, residuals, the lists of points that are not
positions).
"""

import re
from fractions import Fraction
from pathlib import Path

import numpy as np

from motionkit.core.errors import FormatError
from motionkit.core.framerate import parse_fps
from motionkit.core.motion import Motion
from motionkit.core.timegrid import TimeGrid
from motionkit.io import source_file
from motionkit.io.body_frame import AXES, log_lines, to_y_up
from motionkit.io.bvh import unique_names
from motionkit.io.c3d_container import C3dFile, parse_c3d
from motionkit.io.markers import UNITS, Markers, checked_metres, marker_skeleton, some, without_gaps
from motionkit.io.registry import Format, ReadOptions, of_path

# Vicon's models store angles, forces and the like among the points, and list them.
NO_POSITIONS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS")
ASSUMED_UP = "z"


def read_c3d(path: Path, options: ReadOptions | None = None) -> Motion:
    """Read the markers of one file as positions in metres, y up; unlabelled ones and model outputs are left out.

    Up is the axis in POINT:Y_SCREEN, by default z, with the sign of most markers' coordinates (vendors disagree about
    the sign); the unit is POINT:UNITS, by default mm. A marker is not visible if its residual is negative, or it is NaN
    or exactly 0, 0, 0. The largest block of markers and frames without a gap longer than 0.1 s is kept; shorter gaps
    are filled linearly, at the ends of the take with the nearest position. All of this is in the operation log. Raises
    `FormatError`, with the reason `gaps` if no marker remains.
    """
    options = options or ReadOptions()
    data = source_file.read_bytes(path)
    file = parse_c3d(data, path)
    stated = file.numbers("POINT:RATE")
    rate = stated[0] if stated else file.header_rate
    fps, log = source_file.fps_in_use(options.fps, lambda: _stated_fps(rate, path), words=f"{rate:g}")
    markers = without_gaps(_labelled(file, path), fps, path)
    unit, why = _unit(file, options, path)
    up, axis_log = (options.up, log_lines(options.up, options.up)) if options.up else _up(file, markers, path)
    metres = to_y_up(markers.positions, up) * unit
    positions = checked_metres(markers, metres, path)
    log += [*markers.operations, f"lengths × {unit:g} to metres ({why})", *axis_log]
    subjects = file.texts("SUBJECTS:NAMES")
    return Motion(
        joint_positions=positions,
        skeleton=marker_skeleton(markers.names),
        timegrid=TimeGrid(fps, len(positions)),
        sequence_id=path.stem,
        provenance=source_file.provenance(
            path, data, "c3d", log, subject=subjects[0] if len(subjects) == 1 else "", stated_fps=f"POINT:RATE {rate:g}"
        ),
    )


def _stated_fps(rate: float, path: Path) -> Fraction:
    try:
        return parse_fps(float(rate))
    except ValueError as error:
        raise FormatError(f"POINT:RATE {rate:g} ({error}); give --fps", path=path, reason="frame-time") from None


def _labelled(file: C3dFile, path: Path) -> Markers:
    # Labelled markers that are positions, NaN where not visible.
    num_points = file.points.shape[1]
    numbered = sorted(name for name in file.parameters if re.fullmatch(r"POINT:LABELS\d*", name))
    labels = [label for name in sorted(numbered, key=len) for label in file.texts(name)][:num_points]
    labels += [""] * (num_points - len(labels))
    other = {label for group in NO_POSITIONS for label in file.texts(f"POINT:{group}") if label}
    unlabelled = [not label or label.startswith("*") for label in labels]
    operations = []
    if all(unlabelled):
        labels, unlabelled = [f"marker_{number + 1}" for number in range(num_points)], [False] * num_points
        operations.append("markers numbered: none has a label")
    kept = [point for point in range(num_points) if not unlabelled[point] and labels[point] not in other]
    if any(unlabelled):
        operations.append(f"{sum(unlabelled)} unlabelled trajectories left out")
    modelled = [label for label in labels if label in other]
    if modelled:
        operations.append(f"no positions, left out: {some(modelled)}")
    if not kept:
        raise FormatError("no point is a labelled marker", path=path, reason="no-markers")
    names, renamed = unique_names(_without_subject([labels[point] for point in kept]))
    points = file.points[:, kept]
    positions = points[..., :3].copy()
    if np.isinf(positions).any():
        frame = int(np.nonzero(np.isinf(positions))[0][0])
        raise FormatError("infinite, expected a position", path=path, reason="range", frame=frame)
    positions[(points[..., 3] < 0) | ~positions.any(axis=-1) | np.isnan(points).any(axis=-1)] = np.nan
    return Markers(names, positions, (*operations, *renamed))


def _without_subject(labels: list[str]) -> list[str]:
    # "Anna:LFHD" → "LFHD", if all have the same subject.
    prefixes = {label.partition(":")[0] if ":" in label else "" for label in labels}
    return [label.partition(":")[2] for label in labels] if len(prefixes) == 1 and "" not in prefixes else labels


def _unit(file: C3dFile, options: ReadOptions, path: Path) -> tuple[float, str]:
    stated = file.texts("POINT:UNITS")
    if options.unit_metres is not None:
        return options.unit_metres, "given"
    if not stated or not stated[0]:
        return UNITS["mm"], "POINT:UNITS says nothing: mm, as is usual"
    if stated[0].lower() not in UNITS:
        raise FormatError(
            f"POINT:UNITS is {stated[0][:20]!r}, expected one of {', '.join(UNITS)}; say how long a unit is with "
            "--unit-metres",
            path=path,
            reason="unit",
        )
    return UNITS[stated[0].lower()], f"POINT:UNITS is {stated[0]}"


def _up(file: C3dFile, markers: Markers, path: Path) -> tuple[str, list[str]]:
    stated = next(iter(file.texts("POINT:Y_SCREEN")), "").upper()
    up = stated.lower().removeprefix("+") or ASSUMED_UP
    if up not in AXES:
        axes = ", ".join(axis.upper() if axis[0] == "-" else f"+{axis.upper()}" for axis in AXES)
        raise FormatError(f"POINT:Y_SCREEN is {stated[:20]!r}, expected one of {axes}", path=path, reason="parameters")
    why = f"POINT:Y_SCREEN is {stated}" if stated else "POINT:Y_SCREEN says nothing: z up, as is usual"
    heights = to_y_up(markers.positions, up)[..., 1]
    below = bool(np.median(heights) < 0)
    if below:
        up = up[1:] if up[0] == "-" else f"-{up}"
        why += ", but that way most markers would be below the floor"
    return up, [] if up == "y" and not below else [f"turned from {up.replace('-', '−')} up to y up ({why})"]


FORMAT = Format(
    name="c3d",
    read=of_path(read_c3d),
    suffixes=(".c3d",),
    turns_up=True,
)
