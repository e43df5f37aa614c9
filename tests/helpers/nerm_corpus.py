"""A small corpus in memory whose motions are known at every instant."""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np

from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import rest_positions
from motionkit.store.cache import PositionCache


def analytic_positions(seconds: np.ndarray, kind: int) -> np.ndarray:
    """A swinging, swaying body that walks along Z at 0.5 m/s; float32 [times, 22, 3]."""
    phases = np.linspace(0, 3, 22) + kind
    swing = 0.08 * np.sin(2 * np.pi * (0.5 + 0.1 * kind) * seconds[:, None] + phases)
    positions = np.repeat(rest_positions(SMPL22)[None].astype(np.float64), len(seconds), axis=0)
    positions[:, :, 0] += swing
    positions[:, :, 2] += 0.5 * swing + 0.5 * seconds[:, None]
    positions[:, :, 1] += 0.9 + 0.03 * np.sin(2 * np.pi * seconds)[:, None]
    return positions.astype(np.float32)


def corpus_in_memory(sequences: Sequence[np.ndarray], fps: Sequence[Fraction]) -> PositionCache:
    """Sequences of positions as a cache of a store has them."""
    frames = np.array([len(positions) for positions in sequences], dtype=np.int32)
    return PositionCache(
        path=Path(),
        layout=SMPL22.name,
        where=None,
        store_fingerprint="",
        positions=np.concatenate(sequences).astype(np.float32),
        sequence_index=np.arange(len(frames), dtype=np.int32),
        start_row=np.cumsum(frames).astype(np.int64) - frames,
        num_frames=frames,
        fps_numerator=np.array([rate.numerator for rate in fps], dtype=np.int64),
        fps_denominator=np.array([rate.denominator for rate in fps], dtype=np.int64),
        skipped=(),
    )


def analytic_source(rates: tuple[int, ...] = (120, 60, 30, 120), seconds: float = 4.0) -> PositionCache:
    """One sequence per framerate, each another motion."""
    times = [np.arange(int(seconds * rate) + 1) / rate for rate in rates]
    sequences = [analytic_positions(each, kind) for kind, each in enumerate(times)]
    return corpus_in_memory(sequences, [Fraction(rate) for rate in rates])


FPS = tuple(Fraction(rate) for rate in (20, 40, 60, 100, 120))
