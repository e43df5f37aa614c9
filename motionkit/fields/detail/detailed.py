"""A motion field that adds detail above 10 Hz to another one."""

from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, lru_cache

import numpy as np

from motionkit.core.errors import UsageError
from motionkit.core.shapes import Float64
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.fields.detail.displaced import displaced
from motionkit.fields.detail.model import NUM_JOINTS, Detail
from motionkit.fields.detail.slow_motion import EDGES_HZ, GRID_FPS, MARGIN, band_power, slow_motion, to_world, with_ends
from motionkit.fields.motion_field import MotionField, Poses, at_fps, check_times
from motionkit.fields.resample import kernel, kernel_shape

BLOCK = 30 * GRID_FPS
BLOCKS_KEPT = 4
TIMES_AT_ONCE = 4096


@dataclass(frozen=True, eq=False)
class Displacements:
    """Joint displacements on the grid, k / 120 s after the field's start; a function of field, detail and seeds.

    Computed in blocks of 30 s on demand: results don't depend on block boundaries, and memory doesn't grow with the
    motion.
    """

    field: MotionField
    detail: Detail
    seeds: tuple[int, int]

    @cached_property
    def count(self) -> int:
        """Number of grid samples inside the field's domain."""
        return int(np.floor((self.field.end_seconds - self.field.start_seconds) * GRID_FPS + 1e-6)) + 1

    def at(self, start: int, stop: int) -> Float64[np.ndarray, "instants coordinates"]:
        """Joint displacements at samples [start, stop), metres; zero outside the domain."""
        found = np.zeros((stop - start, 3 * NUM_JOINTS))
        for number in range(max(0, start) // BLOCK, (min(stop, self.count) - 1) // BLOCK + 1):
            first = max(start, number * BLOCK)
            last = min(stop, self.count, (number + 1) * BLOCK)
            found[first - start : last - start] = _block(self, number)[first - number * BLOCK : last - number * BLOCK]
        return found

    def block(self, number: int) -> Float64[np.ndarray, "instants coordinates"]:
        """Computes the displacements of block `number`."""
        start, stop = number * BLOCK, min(self.count, (number + 1) * BLOCK)
        first, last = max(0, start - MARGIN), min(self.count, stop + MARGIN)
        times = self.field.start_seconds + np.arange(first, last) / GRID_FPS
        inside = self.field.query(np.minimum(times, self.field.end_seconds)).joint_positions
        positions = with_ends(inside, first - (start - MARGIN), stop + MARGIN - last)
        slow = slow_motion(positions)
        # Power that the motion already has in a band is not added again.
        strength = np.sqrt(np.maximum(self.detail.power(slow) - band_power(positions), 0.0))
        noise = self.detail.noise(self.seeds, start, stop)
        made = np.einsum("tbj,btjx->tjx", strength, noise)
        return to_world(made, slow.facing).reshape(stop - start, -1)


@lru_cache(BLOCKS_KEPT)
def _block(displacements: Displacements, number: int) -> Float64[np.ndarray, "instants coordinates"]:
    """Cache of the last computed blocks, shared by all motions: thousands of them may be alive at once."""
    return displacements.block(number)


@dataclass(frozen=True, eq=False)
class DetailedField:
    """Wraps a `MotionField`: its poses with added motion above 10 Hz, as strong as in captures of similar motion.

    The power is predicted from the slow motion around each sample, per joint and band; the signal is random, given
    the seed. It is one function of time for all framerates: a 120 Hz grid, interpolated by windowed sincs. `at_fps`
    low-passes it below half the framerate with the kernels of `resample_positions`, so 30 fps is 60 fps filtered.
    Without a framerate, and above 120 fps, it is limited to 60 Hz. Bones keep their length.
    """

    field: MotionField
    displacements: Displacements
    fps: Fraction | None = None

    @property
    def skeleton(self) -> Skeleton:
        """Same as the wrapped field's."""
        return self.field.skeleton

    @property
    def start_seconds(self) -> float:
        """Same as the wrapped field's."""
        return self.field.start_seconds

    @property
    def end_seconds(self) -> float:
        """Same as the wrapped field's."""
        return self.field.end_seconds

    def at_fps(self, fps: Fraction) -> "DetailedField":
        """The same motion for this framerate, without frequencies above its Nyquist frequency."""
        return replace(self, field=at_fps(self.field, fps), fps=fps)

    def query(self, times_seconds: Float64[np.ndarray, "times"]) -> Poses:
        """Poses at any times inside the domain, in any order; raises `ValueError` outside it."""
        check_times(self, times_seconds)
        poses = self.field.query(times_seconds)
        if self.fps is not None and self.fps <= 2 * EDGES_HZ[0]:
            return poses
        result = poses.copy()
        for start in range(0, len(times_seconds), TIMES_AT_ONCE):
            rows = slice(start, start + TIMES_AT_ONCE)
            result.put(rows, displaced(poses.rows(rows), self.steps(times_seconds[rows]), self.skeleton))
        return result

    def steps(self, times_seconds: Float64[np.ndarray, "times"]) -> Float64[np.ndarray, "times joints 3"]:
        """Joint displacements before projection onto bones, metres."""
        from scipy.sparse import csr_array

        reach, cutoff = kernel_shape(max(Fraction(1), Fraction(GRID_FPS) / (self.fps or GRID_FPS)))
        taps = np.arange(-reach, reach + 1)
        scale = 2 * cutoff / kernel(np.zeros((1, 1)), reach, cutoff)
        found = np.zeros((len(times_seconds), 3 * NUM_JOINTS))
        place = (times_seconds - self.start_seconds) * GRID_FPS
        whole = np.round(place).astype(np.int64)
        blocks = whole // BLOCK
        for number in np.unique(blocks).tolist():
            rows = np.flatnonzero(blocks == number)
            first = int(whole[rows].min()) - reach
            grid = self.displacements.at(first, int(whole[rows].max()) + reach + 1)
            phases, phase_of_row = np.unique(np.round(place[rows] - whole[rows], 9), return_inverse=True)
            weights = kernel(phases[:, None] - taps, reach, cutoff) * scale
            columns = whole[rows, None] - first + taps
            pointers = np.arange(len(rows) + 1) * len(taps)
            matrix = csr_array((weights[phase_of_row].ravel(), columns.ravel(), pointers), (len(rows), len(grid)))
            found[rows] = matrix @ grid
        return found.reshape(len(times_seconds), NUM_JOINTS, 3)


def detailed(field: MotionField, detail: Detail, *, seed: int, number: int = 0) -> DetailedField:
    """A field with detail: motion `number` of a seed.

    Raises `UsageError` for skeletons other than the 22 joints.
    """
    if field.skeleton.joint_names != SMPL22.joint_names:
        raise UsageError(
            f"detail is known for the joints of {SMPL22.name}, the motion has those of {field.skeleton.name!r}"
        )
    return DetailedField(field, Displacements(field, detail, (seed, number)))
