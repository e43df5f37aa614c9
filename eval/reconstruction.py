"""Errors of windows of motion that an encoder reconstructs (Table 4 and the ablations).

The ground truth at s fps is the capture, low-passed and downsampled if its framerate is higher; sequences slower than s
have none and are left out.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from fractions import Fraction

import numpy as np

from eval.metrics.motion import mean_vector_distance, mpjpe_global, mpjpe_root_aligned, mre
from eval.report.results import Cell
from motionkit.core.motion import mirror_positions
from motionkit.core.shapes import Bool, Float32, Int64
from motionkit.core.skeleton import SMPL22
from motionkit.data.reconstruction import ModelWindows
from motionkit.data.windows import Windows
from motionkit.features import field
from motionkit.features.native import vectors
from motionkit.fields.motion_field import to_motion
from motionkit.fields.resample import resample_positions
from motionkit.store.cache import PositionCache

GLOBAL, DISTANCE, COUNT = "global MPJPE, mm", "L2 norm of the whole vector", "windows"


def window_truth(
    source: PositionCache, windows: Windows, row: int, fps: Fraction
) -> Float32[np.ndarray, "poses joints 3"]:
    """A window's own capture at `fps` (not above its native framerate), in the window's frame; metres."""
    start, count = int(windows.start_row[row]), int(windows.num_frames[row])
    positions = np.asarray(source.positions[start : start + count])
    if windows.mirrored[row]:
        positions = mirror_positions(positions, SMPL22.left_right_pairs)
    sampled = resample_positions(positions, windows.exact_fps(row), fps)
    chosen = slice(row, row + 1)
    return np.asarray(field.to_window(sampled[None], windows.yaw[chosen], windows.origin[chosen])[0])


def has_truth(windows: Windows, fps: Fraction) -> Bool[np.ndarray, "windows"]:
    """Which windows were captured at `fps` or faster."""
    return np.asarray(windows.fps >= float(fps) - 1e-6)


def separate_windows(windows: Windows) -> Int64[np.ndarray, "chosen"]:
    """Rows of windows that do not overlap and are not mirrored: each sequence's first, then the next free one, …"""
    originals = np.flatnonzero(~windows.mirrored)
    order = originals[np.lexsort((windows.start_frame[originals], windows.sequence_index[originals]))]
    chosen: list[int] = []
    free_from: dict[int, int] = defaultdict(int)
    for row in order.tolist():
        sequence, start = int(windows.sequence_index[row]), int(windows.start_frame[row])
        # Neighbours share the frame at which one ends and the next begins.
        if start >= free_from[sequence]:
            chosen.append(row)
            free_from[sequence] = start + int(windows.num_frames[row]) - 1
    return np.array(chosen, dtype=np.int64)


@dataclass(frozen=True)
class WindowErrors:
    """Root-aligned and global MPJPE in millimetres; MRE and mean distance of `native` vectors in their raw units."""

    aligned_mm: float
    global_mm: float
    mre: float
    vector_distance: float
    seconds: float


def window_errors(
    decoded: Float32[np.ndarray, "poses joints 3"],
    truth: Float32[np.ndarray, "poses joints 3"],
    fps: Fraction,
    seconds: float,
) -> WindowErrors:
    """The errors of one window of some seconds, decoded at `fps`; both in the window's frame, metres."""
    positions = 1000.0 * mpjpe_root_aligned(decoded, truth), 1000.0 * mpjpe_global(decoded, truth)
    found, expected = vectors(decoded, "smpl22", fps), vectors(truth, "smpl22", fps)
    return WindowErrors(*positions, mre(found, expected), mean_vector_distance(found, expected), seconds)


def error_cells(windows: Sequence[WindowErrors]) -> dict[str, Cell]:
    """MPJPE in millimetres and MRE by metric, windows weighing by duration."""
    *errors, seconds = np.array([astuple(window) for window in windows]).T
    aligned, whole, vector, distance = (float(np.average(each, weights=seconds)) for each in errors)
    return {
        "mpjpe": Cell(aligned, None, {GLOBAL: whole, COUNT: float(len(windows))}),
        "mre": Cell(vector, None, {DISTANCE: distance}),
    }


# Errors by framerate, then by the window's row.
Errors = dict[Fraction, dict[int, WindowErrors]]


def reconstruction_errors(source: ModelWindows, rates: Sequence[Fraction], most_windows: int, seed: int) -> Errors:
    """With what errors a model reconstructs windows, by framerate and row: random ones, at most `most_windows`.

    Those fast enough for all framerates come first. Windows without a ground truth have no errors.
    """
    shuffled = np.random.default_rng(seed).permutation(separate_windows(source.windows))
    fast = has_truth(source.windows, max(rates))[shuffled]
    rows = np.sort(np.concatenate((shuffled[fast], shuffled[~fast]))[:most_windows])
    windows, fields, errors = source.windows.select(rows), source.fields(rows), Errors()
    for fps in rates:
        errors[fps] = {}
        for row in np.flatnonzero(has_truth(windows, fps)).tolist():
            truth = window_truth(source.source, windows, row, fps)
            decoded = to_motion(fields[row], fps).joint_positions[:, : truth.shape[1]]
            errors[fps][row] = window_errors(decoded, truth, fps, float(windows.duration_seconds[row]))
    return errors
