"""What the field makes of motions beside the motions themselves: what Table 4 measures.

The truth at s fps is the capture itself, brought down band-limited where its own framerate is higher; a take slower
than s has no truth there and is left out. Training windows are decoded from their μ, others from a z that is found by
optimisation.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import torch
from jaxtyping import Bool, Float32, Int64

from motionkit.clips.frame_vectors import FrameVectors
from motionkit.clips.poses import WindowPoses
from motionkit.clips.windows import PositionSource, Windows
from motionkit.features import field as field_vectors
from motionkit.mirror import mirror_positions
from motionkit.motionfield import to_motion
from motionkit.resample import resample_positions
from motionkit.skeleton import SMPL22
from nerm.field.encoding import encode_by_optimisation
from nerm.field.trained import TrainedField

POSES_TO_ENCODE_FROM = 100
WINDOWS_AT_ONCE = 64


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
    return np.asarray(field_vectors.to_window(sampled[None], windows.yaw[chosen], windows.origin[chosen])[0])


def reconstructions(
    trained: TrainedField,
    source: PositionSource,
    windows: Windows,
    latents: Float32[torch.Tensor, "windows latent"],
    fps: Fraction,
) -> Iterator[Reconstruction]:
    """Windows that have a truth at `fps`, one by one, each decoded from its latent at that framerate."""
    for row in np.flatnonzero(windows.fps >= float(fps) - 1e-6).tolist():
        truth = window_truth(source, windows, row, fps)
        seconds = float(windows.duration_seconds[row])
        found = to_motion(trained.as_motion_field(latents[row], seconds), fps).joint_positions
        yield Reconstruction(found, truth, seconds)


def encode_windows(
    trained: TrainedField,
    source: PositionSource,
    windows: Windows,
    frames: FrameVectors | None = None,
    *,
    num_poses: int = POSES_TO_ENCODE_FROM,
) -> Float32[torch.Tensor, "windows latent"]:
    """The latents of windows that were not in training, by optimisation on `num_poses` native poses of each.

    `source` and `frames` are what the field's own vectors opened (without `frames`: positions).
    """
    poses = WindowPoses(source, windows, SMPL22.left_right_pairs, frames=frames)
    parts = [
        encode_by_optimisation(
            trained, poses.evenly(np.arange(start, min(start + WINDOWS_AT_ONCE, len(windows))), num_poses)
        )
        for start in range(0, len(windows), WINDOWS_AT_ONCE)
    ]
    return torch.cat(parts)


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
    """Which windows have a truth at every one of the framerates."""
    return np.asarray(windows.fps >= float(max(rates)) - 1e-6)
