"""A small corpus in memory whose motions are known at every instant."""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from motionkit.core.skeleton import SMPL22


@dataclass(frozen=True, eq=False)
class MemorySource:
    positions: np.ndarray
    sequence_index: np.ndarray
    start_row: np.ndarray
    num_frames: np.ndarray
    fps_numerator: np.ndarray
    fps_denominator: np.ndarray


def analytic_positions(seconds: np.ndarray, kind: int) -> np.ndarray:
    """A swinging, swaying body that walks along Z at 0.5 m/s; float32 [times, 22, 3]."""
    rest = np.zeros((22, 3))
    for joint in range(1, 22):
        rest[joint] = rest[SMPL22.parents[joint]] + SMPL22.offsets[joint]
    phases = np.linspace(0, 3, 22) + kind
    swing = 0.08 * np.sin(2 * np.pi * (0.5 + 0.1 * kind) * seconds[:, None] + phases)
    positions = np.repeat(rest[None], len(seconds), axis=0)
    positions[:, :, 0] += swing
    positions[:, :, 2] += 0.5 * swing + 0.5 * seconds[:, None]
    positions[:, :, 1] += 0.9 + 0.03 * np.sin(2 * np.pi * seconds)[:, None]
    return positions.astype(np.float32)


def analytic_source(rates: tuple[int, ...] = (120, 60, 30, 120), seconds: float = 4.0) -> MemorySource:
    """One sequence per framerate, each another motion."""
    frames = np.array([int(seconds * rate) + 1 for rate in rates], dtype=np.int32)
    sequences = [
        analytic_positions(np.arange(count) / rate, kind)
        for kind, (count, rate) in enumerate(zip(frames, rates, strict=True))
    ]
    return MemorySource(
        np.concatenate(sequences),
        np.arange(len(rates), dtype=np.int32),
        np.cumsum(frames).astype(np.int64) - frames,
        frames,
        np.array(rates, dtype=np.int64),
        np.ones(len(rates), dtype=np.int64),
    )


FPS = tuple(Fraction(rate) for rate in (20, 40, 60, 100, 120))
