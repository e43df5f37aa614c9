"""C3D markers: points of a capture without bones, at the point rate, in metres and y up.

A motion of markers has the first marker as its root and all others as the root's children, with offsets of zero: a
skeleton that says nothing but their names. A `--skeleton-map` makes the 22 joints from them. Source: "The C3D File
Format User Guide", Motion Lab Systems 2021, https://www.c3d.org (units, screen axes, residuals, the lists of points
that are no positions).
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from motionkit.core.errors import FormatError
from motionkit.core.framerate import parse_fps
from motionkit.core.motion import Motion
from motionkit.core.skeleton import Skeleton
from motionkit.core.timegrid import TimeGrid
from motionkit.formats.bvh import channels
from motionkit.formats.c3d_container import C3dFile, parse_c3d
from motionkit.formats.format import Format, of_path
from motionkit.formats.scan.items import ReadOptions
from motionkit.formats.source import clock, source_file

# Ends of stretches are looked for on a grid of so many steps; a take has some hundred markers that come and go.
GRID_STEPS = 256

Runs = tuple[Int64[np.ndarray, "runs"], Int64[np.ndarray, "runs"], Int64[np.ndarray, "runs"]]


@dataclass(frozen=True)
class Block:
    """Frames [start, stop) and the markers that are seen throughout, short gaps aside; empty where there are none."""

    start: int
    stop: int
    markers: Bool[np.ndarray, "markers"]


def runs_of(mask: Bool[np.ndarray, "frames markers"]) -> Runs:
    """Marker, first frame, and frame after the last of every run of True, by marker."""
    edges = np.zeros((mask.shape[1], len(mask) + 2), np.int8)
    edges[:, 1:-1] = mask.T
    change = np.diff(edges, axis=1)
    marker, start = np.nonzero(change == 1)
    return marker, start, np.nonzero(change == -1)[1]


def largest_block(missing: Bool[np.ndarray, "frames markers"], max_gap: int) -> Block:
    """The stretch of frames with most markers × frames, of markers without a gap longer than `max_gap` frames in it.

    Exact for takes of up to 256 frames; in longer ones the ends are looked for on a grid of 256 steps and then moved
    out as far as the markers that were found allow.
    """
    num_frames, num_markers = missing.shape
    marker, start, stop = _visible_runs(missing, max_gap)
    grid = np.unique(np.linspace(0, num_frames, min(num_frames, GRID_STEPS) + 1).astype(np.int64))
    first, last = np.searchsorted(grid, start), np.searchsorted(grid, stop, side="right") - 1
    within = first < last
    # counts[a, b]: markers with a run that begins by grid step a and ends no sooner than b.
    counts = np.zeros((len(grid), len(grid)), np.int64)
    np.add.at(counts, (first[within], last[within]), 1)
    counts = np.cumsum(np.cumsum(counts, axis=0)[:, ::-1], axis=1)[:, ::-1]
    best = int(np.argmax(counts * np.maximum(grid[None, :] - grid[:, None], 0)))
    low, high = divmod(best, len(grid))
    covers = within & (first <= low) & (last >= high)
    kept = np.zeros(num_markers, np.bool_)
    kept[marker[covers]] = True
    if low >= high or not covers.any():
        return Block(0, 0, np.zeros(num_markers, np.bool_))
    return Block(int(start[covers].max()), int(stop[covers].min()), kept)


def _visible_runs(missing: Bool[np.ndarray, "frames markers"], max_gap: int) -> Runs:
    # Runs of frames in which a marker is seen, gaps of up to `max_gap` frames aside.
    marker, start, stop = runs_of(missing)
    never = np.asarray(missing.all(axis=0), np.bool_)
    long = (stop - start > max_gap) | never[marker]
    steps = np.zeros((missing.shape[1], len(missing) + 1), np.int64)
    steps[marker[long], start[long]] += 1
    steps[marker[long], stop[long]] -= 1
    return runs_of(np.cumsum(steps, axis=1)[:, :-1].T == 0)


UNITS = {"mm": 0.001, "cm": 0.01, "dm": 0.1, "m": 1.0, "in": 0.0254, "inch": 0.0254, "ft": 0.3048}
# Linear filling of 0.1 s is off by a·t²/8: 6 mm at 5 m/s².
MAX_GAP_SECONDS = Fraction(1, 10)
MAX_METRES = 1e5
# Vicon's models put angles, forces and the like among the points, and list them.
NO_POSITIONS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS")
# From the axis that points up to a turn (det +1) that makes it +y.
TURNS = {
    "+X": ((1, 0, 2), (-1, 1, 1)),
    "-X": ((1, 0, 2), (1, -1, 1)),
    "+Y": ((0, 1, 2), (1, 1, 1)),
    "-Y": ((0, 1, 2), (1, -1, -1)),
    "+Z": ((0, 2, 1), (1, 1, -1)),
    "-Z": ((0, 2, 1), (1, -1, 1)),
}
ASSUMED_UP = "+Z"


@dataclass(frozen=True)
class _Markers:
    names: tuple[str, ...]
    positions: Float64[np.ndarray, "frames markers 3"]
    operations: tuple[str, ...]


def read_c3d(path: Path, options: ReadOptions | None = None) -> Motion:
    """Read the markers of one file as positions in metres, y up; unlabelled ones and model outputs are left out.

    Up is the axis that POINT:Y_SCREEN names, z where it names none, in the direction in which most markers are (makers
    disagree about the sign); the unit is POINT:UNITS, mm where it says nothing. A marker was not seen where its
    residual is negative, or it is NaN or exactly 0, 0, 0. Kept are the markers and the stretch of frames of which most
    positions remain without a gap longer than 0.1 s; shorter gaps are filled linearly, at the ends of the take with the
    nearest position. All of it is in the operation log. Raises `FormatError`, with the reason `gaps` where no marker
    remains.
    """
    options = options or ReadOptions()
    data = source_file.read_bytes(path)
    file = parse_c3d(data, path)
    stated = file.numbers("POINT:RATE")
    rate = stated[0] if stated else file.header_rate
    fps, log = clock.fps_in_use(options.fps, lambda: _stated_fps(rate, path), words=f"{rate:g}")
    markers = _without_gaps(_labelled(file, path), fps, path)
    unit, why = _unit(file, options, path)
    up, axis_log = _up(file, markers, path)
    positions = _metres(markers, unit, up, path)
    skeleton = Skeleton(
        name="markers",
        joint_names=markers.names,
        parents=(-1, *([0] * (len(markers.names) - 1))),
        offsets=np.zeros((len(markers.names), 3), np.float32),
    )
    log += [*markers.operations, f"lengths × {unit:g} to metres ({why})", *axis_log]
    subjects = file.texts("SUBJECTS:NAMES")
    return Motion(
        joint_positions=positions,
        skeleton=skeleton,
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


def _labelled(file: C3dFile, path: Path) -> _Markers:
    # Markers with a label that are positions, NaN where they were not seen.
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
        operations.append(f"no positions, left out: {_some(modelled)}")
    if not kept:
        raise FormatError("no point is a labelled marker", path=path, reason="no-markers")
    names, renamed = channels.unique_names(_without_subject([labels[point] for point in kept]))
    points = file.points[:, kept]
    positions = points[..., :3].copy()
    if np.isinf(positions).any():
        frame = int(np.nonzero(np.isinf(positions))[0][0])
        raise FormatError("infinite, expected a position", path=path, reason="range", frame=frame)
    positions[(points[..., 3] < 0) | ~positions.any(axis=-1) | np.isnan(points).any(axis=-1)] = np.nan
    return _Markers(names, positions, (*operations, *renamed))


def _without_subject(labels: list[str]) -> list[str]:
    # "Anna:LFHD", where all are Anna's.
    prefixes = {label.partition(":")[0] if ":" in label else "" for label in labels}
    return [label.partition(":")[2] for label in labels] if len(prefixes) == 1 and "" not in prefixes else labels


def _without_gaps(markers: _Markers, fps: Fraction, path: Path) -> _Markers:
    missing = np.isnan(markers.positions[..., 0])
    block = largest_block(missing, int(MAX_GAP_SECONDS * fps))
    gap = f"{float(MAX_GAP_SECONDS):g} s"
    if block.start == block.stop:
        raise FormatError(
            f"no marker is seen for any time without gaps longer than {gap}; fill them in the capture software",
            path=path,
            reason="gaps",
        )
    operations = list(markers.operations)
    if block.stop - block.start < len(missing):
        stretch = f"frames [{block.start}, {block.stop}) of {len(missing)}"
        operations.append(f"{stretch} kept, throughout which most markers are seen")
    stays = block.markers.tolist()
    lost = [name for name, kept in zip(markers.names, stays, strict=True) if not kept]
    if lost:
        operations.append(f"{len(lost)} markers dropped, not seen for longer than {gap}: {_some(lost)}")
    positions, filled = _filled(markers.positions[:, block.markers], missing[:, block.markers], block)
    names = tuple(name for name, kept in zip(markers.names, stays, strict=True) if kept)
    return _Markers(names, positions, (*operations, *filled))


def _filled(
    positions: Float64[np.ndarray, "frames markers 3"], missing: Bool[np.ndarray, "frames markers"], block: Block
) -> tuple[Float64[np.ndarray, "kept markers 3"], list[str]]:
    # What is left out beyond the block still says where a marker was on the other side of a gap.
    kept = positions[block.start : block.stop].copy()
    gone = missing[block.start : block.stop]
    for marker in np.flatnonzero(gone.any(axis=0)):
        frames, seen = np.flatnonzero(gone[:, marker]), np.flatnonzero(~missing[:, marker])
        for axis in range(3):
            kept[frames, marker, axis] = np.interp(frames + block.start, seen, positions[seen, marker, axis])
    if not gone.any():
        return kept, []
    _, start, stop = runs_of(gone)
    return kept, [
        f"gaps filled linearly: {int(gone.sum())} positions of {int(gone.any(axis=0).sum())} markers, the longest "
        f"{int((stop - start).max())} frames"
    ]


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


def _up(file: C3dFile, markers: _Markers, path: Path) -> tuple[str, list[str]]:
    stated = next(iter(file.texts("POINT:Y_SCREEN")), "").upper()
    up = f"+{stated}" if stated in ("X", "Y", "Z") else stated or ASSUMED_UP
    if up not in TURNS:
        raise FormatError(
            f"POINT:Y_SCREEN is {stated[:20]!r}, expected one of {', '.join(TURNS)}", path=path, reason="parameters"
        )
    why = f"POINT:Y_SCREEN is {stated}" if stated else "POINT:Y_SCREEN says nothing: z up, as is usual"
    heights = markers.positions[..., "XYZ".index(up[1])] * (1 if up[0] == "+" else -1)
    if np.median(heights) < 0:
        up = f"{'-' if up[0] == '+' else '+'}{up[1]}"
        why += ", but that way most markers would be below the floor"
    axis = up.lower().replace("+", "").replace("-", "−")
    return up, [] if up == "+Y" and "but" not in why else [f"turned from {axis} up to y up ({why})"]


def _metres(markers: _Markers, unit: float, up: str, path: Path) -> Float32[np.ndarray, "frames markers 3"]:
    order, signs = TURNS[up]
    positions = markers.positions[..., order] * (np.array(signs, np.float64) * unit)
    bad = ~(np.abs(positions) < MAX_METRES)
    if bad.any():
        frame, marker, _ = (int(index[0]) for index in np.nonzero(bad))
        raise FormatError(
            f"marker {markers.names[marker]} is {positions[frame, marker].tolist()} m from the origin",
            path=path,
            reason="range",
            frame=frame,
        )
    return np.ascontiguousarray(positions, dtype=np.float32)


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")


FORMAT = Format(
    name="c3d",
    read=of_path(read_c3d),
    suffixes=(".c3d",),
)
