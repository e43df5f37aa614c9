"""The nearest training motion to every second of a motion, whatever its body, tempo, side, place and heading.

Motions are compared at 20 fps, low-passed at 5 Hz, as the bones of one reference body. A window is a second, turned to
face Z+ at its middle. It is searched for among all training windows, as it is and mirrored, at tempi from 0.8 to 1.25.
The distance of two windows is the root mean square difference of bones, in metres on the reference body.
"""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from eval.sets.motions import low_pass
from eval.sets.sets import SampleSet
from motionkit.core.motion import mirror_positions
from motionkit.core.shapes import Float32, Float64, Int64
from motionkit.core.skeleton import SMPL22
from motionkit.features.field import heading
from motionkit.fields.resample import resample_positions

FPS = Fraction(20)
SMOOTH_HZ = 5.0
WINDOW_FRAMES = 20
POSES = np.arange(0, WINDOW_FRAMES + 1, 2)
"""Frames of a window that are compared."""
QUERY_EVERY, TRAINING_EVERY = 5, 1
TEMPI = (Fraction(4, 5), Fraction(9, 10), Fraction(1), Fraction(10, 9), Fraction(5, 4))
NUM_COMPONENTS = 48
BASIS_WINDOWS = 2048
QUERIES_AT_ONCE = 512
STILL_METRES = 0.03
"""Windows that move less are near everything: the root mean square deviation of bones from their means."""
HELD_OUT_SHARE = 0.01
"""Share of held-out real motion's windows that the limit calls copied."""
PARENTS = np.array(SMPL22.parents[1:])


def _bone_lengths() -> Float64[np.ndarray, "bones 1"]:
    """Of the reference body, left and right alike, so that a mirrored copy has the same bones."""
    lengths = np.linalg.norm(SMPL22.offsets, axis=-1)
    for pair in SMPL22.left_right_pairs:
        lengths[list(pair)] = lengths[list(pair)].mean()
    return np.asarray(lengths[1:, None], dtype=np.float64)


BONE_LENGTHS = _bone_lengths()


@dataclass(frozen=True, eq=False)
class Nearest:
    """Every moving window of a set: its motion, its distance to training motion in metres, and as a share of movement.

    A window's movement is the root mean square deviation of its bones from their means.
    """

    motion: Int64[np.ndarray, "windows"]
    distance: Float64[np.ndarray, "windows"]
    relative: Float64[np.ndarray, "windows"]


def held_out_limit(held_out: Nearest) -> float:
    """The relative distance that 1 % of held-out real motion's windows are nearer than; 0 without windows."""
    return float(np.quantile(held_out.relative, HELD_OUT_SHARE)) if len(held_out.relative) else 0.0


@dataclass(frozen=True, eq=False)
class TrainingWindows:
    """All windows of training motion: principal components of some of them, and the length of what these leave.

    Distances of such values are at most those of the windows, and equal them for copies.
    """

    mean: Float32[np.ndarray, "numbers"]
    components: Float32[np.ndarray, "numbers components"]
    values: Float32[np.ndarray, "windows values"]

    @classmethod
    def of(cls, training: SampleSet) -> "TrainingWindows":
        """Raises `ValueError` if no motion lasts a second."""
        rows = np.concatenate([_windows(_slow(each, training.fps), TRAINING_EVERY) for each in training.sequences])
        if not len(rows):
            raise ValueError("no training motion lasts a second")
        some = rows[:: -(-len(rows) // BASIS_WINDOWS)]
        mean = some.mean(axis=0)
        components = np.linalg.svd(some - mean, full_matrices=False)[2][:NUM_COMPONENTS].T
        return cls(mean, components, _reduced(rows - mean, components))

    def nearest(self, samples: SampleSet) -> Nearest:
        """The nearest training window to every moving window of a set, a quarter of a second apart."""
        motion, distance, relative = [np.empty(0, np.int64)], [np.empty(0)], [np.empty(0)]
        for number, positions in enumerate(samples.sequences):
            windows = []
            for tempo in TEMPI:
                slow = _slow(positions, samples.fps * tempo)
                mirrored = mirror_positions(slow, SMPL22.left_right_pairs)
                windows += [_windows(slow, QUERY_EVERY, tempo), _windows(mirrored, QUERY_EVERY, tempo)]
            count = min(map(len, windows))
            own = windows[2 * TEMPI.index(Fraction(1))][:count].reshape(count, len(POSES), len(PARENTS) * 3)
            deviation = np.square(own - own.mean(axis=1, keepdims=True)).sum(axis=(1, 2))
            movement = np.sqrt(deviation / (len(POSES) * len(PARENTS)))
            moving = movement >= STILL_METRES
            if moving.any():
                nearest = np.min([self._distance(each[:count][moving]) for each in windows], axis=0)
                motion.append(np.full(len(nearest), number))
                distance.append(nearest)
                relative.append(nearest / movement[moving])
        return Nearest(np.concatenate(motion), np.concatenate(distance), np.concatenate(relative))

    def _distance(self, windows: Float32[np.ndarray, "queries numbers"]) -> Float64[np.ndarray, "queries"]:
        """Root mean square difference of bones to the nearest training window."""
        values = _reduced(windows - self.mean, self.components)
        squares, found = np.square(self.values).sum(axis=1), np.empty(len(windows))
        for first in range(0, len(windows), QUERIES_AT_ONCE):
            some = values[first : first + QUERIES_AT_ONCE]
            apart = squares - 2.0 * some @ self.values.T
            found[first : first + len(some)] = apart.min(axis=1) + np.square(some).sum(axis=1)
        return np.asarray(np.sqrt(np.maximum(found, 0.0) / (len(POSES) * len(PARENTS))), dtype=np.float64)


def _reduced(
    centred: Float32[np.ndarray, "windows numbers"], components: Float32[np.ndarray, "numbers components"]
) -> Float32[np.ndarray, "windows values"]:
    projected = centred @ components
    rest = np.square(centred).sum(axis=1) - np.square(projected).sum(axis=1)
    return np.column_stack((projected, np.sqrt(np.maximum(rest, 0.0)))).astype(np.float32)


def _slow(positions: Float32[np.ndarray, "_frames 22 3"], fps: Fraction) -> Float64[np.ndarray, "_slow_frames 22 3"]:
    """Joint positions at 20 fps below 5 Hz; a higher framerate than the motion's plays it faster."""
    return low_pass(resample_positions(positions, fps, FPS).astype(np.float64), float(FPS), SMOOTH_HZ)


def _windows(
    positions: Float64[np.ndarray, "frames 22 3"], every: int, tempo: Fraction = Fraction(1)
) -> Float32[np.ndarray, "windows numbers"]:
    """Flat windows of bones, one every so many frames of the motion at its own tempo, turned to face Z+."""
    starts = np.arange(0, (len(positions) - POSES[-1] - 1) * float(tempo) + 1e-6, every) / float(tempo)
    frames = starts.round().astype(np.int64)[:, None] + POSES
    bones = positions[:, 1:] - positions[:, PARENTS]
    bones *= BONE_LENGTHS / np.maximum(np.linalg.norm(bones, axis=-1, keepdims=True), 1e-6)
    yaw = heading(positions)[frames[:, len(POSES) // 2]]
    cosine, sine = np.cos(yaw)[:, None, None], np.sin(yaw)[:, None, None]
    x, y, z = np.moveaxis(bones[frames], -1, 0)
    turned = np.stack((x * cosine - z * sine, y, x * sine + z * cosine), axis=-1)
    return turned.reshape(len(frames), len(POSES) * len(PARENTS) * 3).astype(np.float32)
