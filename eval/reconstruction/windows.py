"""Windows of motion as a model decodes them, beside the ground truth.

The ground truth at s fps is the capture, low-passed and downsampled if its framerate is higher; sequences slower than s
have none and are left out.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from motionkit.core.mirror import mirror_positions
from motionkit.core.shapes import Bool, Float32, Int64
from motionkit.core.skeleton import SMPL22
from motionkit.data.windows import PositionSource, Windows
from motionkit.features import field
from motionkit.fields.motion_field import MotionField, to_motion
from motionkit.fields.resample import resample_positions


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """One window as decoded and as captured, in the window's frame (metres), and how long it lasts."""

    found: Float32[np.ndarray, "poses joints 3"]
    truth: Float32[np.ndarray, "poses joints 3"]
    seconds: float


def window_truth(
    source: PositionSource, windows: Windows, row: int, fps: Fraction
) -> Float32[np.ndarray, "poses joints 3"]:
    """A window's own capture at `fps` (not above its native framerate), in the window's frame; metres."""
    start, count = int(windows.start_row[row]), int(windows.num_frames[row])
    positions = np.asarray(source.positions[start : start + count])
    if windows.mirrored[row]:
        positions = mirror_positions(positions, SMPL22.left_right_pairs)
    sampled = resample_positions(positions, windows.exact_fps(row), fps)
    chosen = slice(row, row + 1)
    return np.asarray(field.to_window(sampled[None], windows.yaw[chosen], windows.origin[chosen])[0])


def reconstructions(
    source: PositionSource, windows: Windows, fields: Sequence[MotionField], fps: Fraction
) -> Iterator[Reconstruction]:
    """Windows that have a ground truth at `fps`, each with its decoded motion at that framerate."""
    for row in np.flatnonzero(windows.fps >= float(fps) - 1e-6).tolist():
        truth = window_truth(source, windows, row, fps)
        found = to_motion(fields[row], fps).joint_positions[:, : truth.shape[1]]
        yield Reconstruction(found, truth, float(windows.duration_seconds[row]))


def separate_windows(windows: Windows) -> Int64[np.ndarray, "chosen"]:
    """Rows of windows that do not overlap and are not mirrored: each sequence's first, then the next free one, …"""
    originals = np.flatnonzero(~windows.mirrored)
    order = originals[np.lexsort((windows.start_frame[originals], windows.sequence_index[originals]))]
    chosen: list[int] = []
    sequence, free_from = -1, 0
    for row in order.tolist():
        start = int(windows.start_frame[row])
        if windows.sequence_index[row] != sequence:
            sequence, free_from = int(windows.sequence_index[row]), 0
        # Neighbours share the frame at which one ends and the next begins.
        if start >= free_from:
            chosen.append(row)
            free_from = start + int(windows.num_frames[row]) - 1
    return np.array(chosen, dtype=np.int64)


def comparable(windows: Windows, rates: Sequence[Fraction]) -> Bool[np.ndarray, "windows"]:
    """Mask of windows with a ground truth at every one of the framerates."""
    return np.asarray(windows.fps >= float(max(rates)) - 1e-6)
