"""Observations of motions too long for memory: poses are read on demand."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from motionkit.core.shapes import Float64, Int64
from motionkit.core.skeleton import Skeleton
from motionkit.fields.motion_field import Observation, Poses, RemakePoses

FRAMES_AT_ONCE = 1024
# A curve is made of two blocks and some frames of both neighbours.
BLOCKS_KEPT = 4


@dataclass(frozen=True, eq=False)
class LongObservation:
    """The observed frames of a motion that is not in memory (`motionkit.fields.motion_field.Observed`).

    `take` returns the poses of ascending rows, and must be deterministic.
    """

    times_seconds: Float64[np.ndarray, "frames"]
    take: Callable[[Int64[np.ndarray, "rows"]], Poses]
    skeleton: Skeleton

    @property
    def poses(self) -> Poses:
        """All poses, in memory: for encoders that work on a motion as a whole."""
        return self.take(np.arange(len(self)))

    @property
    def start_seconds(self) -> float:
        """Time of the first pose."""
        return float(self.times_seconds[0])

    @property
    def end_seconds(self) -> float:
        """Time of the last pose."""
        return float(self.times_seconds[-1])

    def __len__(self) -> int:
        return len(self.times_seconds)

    def rows(self, rows: np.ndarray | slice) -> Observation:
        """Some of the poses with their times, in memory, by slice, mask or ascending index."""
        if isinstance(rows, slice):
            wanted = np.arange(*rows.indices(len(self)))
        else:
            wanted = np.flatnonzero(rows) if rows.dtype == np.bool_ else rows
        return Observation(self.times_seconds[wanted], self.take(wanted), self.skeleton)

    def remade(self, remake: RemakePoses, skeleton: Skeleton) -> "LongObservation":
        """Poses transformed block by block, each block given the last pose of the one before.

        The first access computes all blocks before it; later ones compute only their own.
        """
        return LongObservation(self.times_seconds, _Remade(self, remake).take, skeleton)


class _Remade:
    """Transformed poses of a long observation; keeps the last pose of every computed block."""

    def __init__(self, source: LongObservation, remake: RemakePoses) -> None:
        self._source = source
        self._remake = remake
        self._last_poses: list[Poses] = []
        self._kept_block = lru_cache(BLOCKS_KEPT)(self._block)

    def take(self, rows: Int64[np.ndarray, "rows"]) -> Poses:
        numbers = rows // FRAMES_AT_ONCE
        first, *others = [
            self._kept_block(number).rows(rows[numbers == number] - number * FRAMES_AT_ONCE)
            for number in np.unique(numbers).tolist() or [0]
        ]
        return first.joined(others)

    def _block(self, number: int) -> Poses:
        for earlier in range(len(self._last_poses), number):
            self._made(earlier)
        return self._made(number)

    def _made(self, number: int) -> Poses:
        start = number * FRAMES_AT_ONCE
        before = self._last_poses[number - 1] if number else None
        made = self._remake(self._source.rows(slice(start, start + FRAMES_AT_ONCE)), before)
        if number == len(self._last_poses):
            self._last_poses.append(made.rows(np.array([-1])))  # a copy: a view would keep the block
        return made
