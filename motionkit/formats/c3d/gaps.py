"""Which markers and which frames of a capture can be kept without filling long gaps."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int64

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
