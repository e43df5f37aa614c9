"""Markers of a capture as joints without bones: their gaps, the selection of markers, their skeleton."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from motionkit.core.errors import FormatError
from motionkit.core.shapes import Bool, Float32, Float64, Int64
from motionkit.core.skeleton import Skeleton

UNITS = {"mm": 0.001, "cm": 0.01, "dm": 0.1, "m": 1.0, "in": 0.0254, "inch": 0.0254, "ft": 0.3048}
# Linear interpolation over 0.1 s has an error of a·t²/8: 6 mm at 5 m/s².
MAX_GAP_SECONDS = Fraction(1, 10)
MAX_METRES = 1e5
# Number of grid steps of the search for a block's ends; a take has about a hundred markers with gaps.
GRID_STEPS = 256

Runs = tuple[Int64[np.ndarray, "runs"], Int64[np.ndarray, "runs"], Int64[np.ndarray, "runs"]]


def runs_of(mask: Bool[np.ndarray, "frames markers"]) -> Runs:
    """Marker, first frame, and frame after the last of every run of True, by marker."""
    edges = np.zeros((mask.shape[1], len(mask) + 2), np.int8)
    edges[:, 1:-1] = mask.T
    change = np.diff(edges, axis=1)
    marker, start = np.nonzero(change == 1)
    return marker, start, np.nonzero(change == -1)[1]


def largest_block(
    missing: Bool[np.ndarray, "frames markers"], max_gap: int
) -> tuple[int, int, Bool[np.ndarray, "markers"]]:
    """Frames [start, stop) and the markers in them without gaps longer than `max_gap` frames: most markers × frames.

    Exact for takes of up to 256 frames; in longer ones the ends are searched on a grid of 256 steps and then extended
    as far as the chosen markers allow.
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
        return 0, 0, np.zeros(num_markers, np.bool_)
    return int(start[covers].max()), int(stop[covers].min()), kept


def _visible_runs(missing: Bool[np.ndarray, "frames markers"], max_gap: int) -> Runs:
    # Runs of frames in which a marker is visible, apart from gaps of up to `max_gap` frames.
    marker, start, stop = runs_of(missing)
    never = np.asarray(missing.all(axis=0), np.bool_)
    long = (stop - start > max_gap) | never[marker]
    steps = np.zeros((missing.shape[1], len(missing) + 1), np.int64)
    steps[marker[long], start[long]] += 1
    steps[marker[long], stop[long]] -= 1
    return runs_of(np.cumsum(steps, axis=1)[:, :-1].T == 0)


@dataclass(frozen=True)
class Markers:
    """Marker names, positions in the file's unit and axes (NaN if not visible), and the operation log."""

    names: tuple[str, ...]
    positions: Float64[np.ndarray, "frames markers 3"]
    operations: tuple[str, ...]


def without_gaps(markers: Markers, fps: Fraction, path: Path) -> Markers:
    """The largest block of markers and frames without gaps longer than 0.1 s, with the shorter gaps filled.

    Gaps are filled linearly, at the ends of the take with the nearest position. Raises `FormatError` (`gaps`) if no
    marker remains.
    """
    missing = np.isnan(markers.positions[..., 0])
    start, stop, stays = largest_block(missing, int(MAX_GAP_SECONDS * fps))
    gap = f"{float(MAX_GAP_SECONDS):g} s"
    if start == stop:
        message = f"every marker has gaps longer than {gap} all the time; fill them in the capture software"
        raise FormatError(message, path=path, reason="gaps")
    operations = list(markers.operations)
    if stop - start < len(missing):
        operations.append(f"frames [{start}, {stop}) of {len(missing)} kept, throughout which most markers are seen")
    lost = [markers.names[marker] for marker in np.flatnonzero(~stays)]
    if lost:
        operations.append(f"{len(lost)} markers dropped, not seen for longer than {gap}: {some(lost)}")
    positions, missing = markers.positions[:, stays], missing[:, stays]
    kept, gone = positions[start:stop].copy(), missing[start:stop]
    for marker in np.flatnonzero(gone.any(axis=0)):
        # Frames outside the block still give a marker's position on the other side of a gap.
        frames, visible = np.flatnonzero(gone[:, marker]), np.flatnonzero(~missing[:, marker])
        for axis in range(3):
            kept[frames, marker, axis] = np.interp(frames + start, visible, positions[visible, marker, axis])
    if gone.any():
        _, first, end = runs_of(gone)
        operations.append(
            f"gaps filled linearly: {int(gone.sum())} positions of {int(gone.any(axis=0).sum())} markers, the longest "
            f"{int((end - first).max())} frames"
        )
    return Markers(tuple(markers.names[marker] for marker in np.flatnonzero(stays)), kept, tuple(operations))


def marker_skeleton(names: tuple[str, ...]) -> Skeleton:
    """A skeleton that only names the markers: the first is the root, all others its children, with offsets of zero."""
    return Skeleton("markers", names, (-1, *([0] * (len(names) - 1))), np.zeros((len(names), 3), np.float32))


def unit_of(stated: str, name: str, unit_metres: float | None, path: Path) -> tuple[float, str]:
    """Metres per unit, as given or as the file's entry `name` states it, and why; raises `FormatError` (`unit`)."""
    if unit_metres is not None:
        return unit_metres, "given"
    if stated.lower() not in UNITS:
        message = f"{name} is {stated[:20]!r}, expected one of {', '.join(UNITS)}; or give --unit-metres"
        raise FormatError(message, path=path, reason="unit")
    return UNITS[stated.lower()], f"{name} is {stated}"


def checked_metres(
    markers: Markers, metres: Float64[np.ndarray, "frames markers 3"], path: Path
) -> Float32[np.ndarray, "frames markers 3"]:
    """Marker positions in metres as float32; raises `FormatError` (`range`) for one 100 km away."""
    bad = ~(np.abs(metres) < MAX_METRES)
    if bad.any():
        frame, marker, _ = (int(index[0]) for index in np.nonzero(bad))
        message = f"marker {markers.names[marker]} is {metres[frame, marker].tolist()} m from the origin"
        raise FormatError(message, path=path, reason="range", frame=frame)
    return np.ascontiguousarray(metres, dtype=np.float32)


def some(names: Sequence[str]) -> str:
    """The first few names, and the number of the others."""
    return ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")
