"""Frame-to-frame measures: the fastest joint, jumps, still poses, jitter."""

from dataclasses import dataclass

import numpy as np

from motionkit.core.shapes import Bool, Float, Float32, Int64

# No capture system sees a body stand still to a micrometre; held frames are equal to the last bit, and those of a
# format that stores differences nearly so.
SAME_METRES = 1e-6

# A jump is a step faster by this much than the joint's steps two frames earlier and later. 500 m/s² over two frames is
# more than bodies do: in takes of running, punching and back flips at 16 … 120 fps the most is 240 m/s², while the
# known glitches of the CMU database begin at 750. At low framerates this would allow anything, so 10 m/s is enough.
JUMP_ACCELERATION = 500.0
MAX_JUMP_SPEED = 10.0


# Of long takes: the differences of all rows are three times as large as their lengths.
ROWS_AT_ONCE = 4096


@dataclass(frozen=True)
class Steps:
    """Measures of the steps between frames; speeds in m/s, times in seconds from the first frame.

    `first_jump_seconds` and `frozen_start_seconds` are None without a jump, and without equal frames. `held_share` is
    the share of frames that are equal to the previous one.
    """

    max_speed: float
    num_jumps: int
    first_jump_seconds: float | None
    held_share: float
    frozen_seconds: float
    frozen_start_seconds: float | None


def measure_steps(squared: Float32[np.ndarray, "steps joints"], fps: float) -> Steps:
    """Measures from the squared lengths of every joint's steps (m²) between neighbouring frames."""
    if not len(squared):
        return Steps(0.0, 0, None, 0.0, 0.0, None)
    longest = longest_steps(squared)
    jumps = _jumps(np.sqrt(squared), fps)
    starts, lengths = _runs(longest == 0.0)
    most = int(lengths.argmax()) if len(lengths) else 0
    return Steps(
        max_speed=float(longest.max() * fps),
        num_jumps=len(jumps),
        first_jump_seconds=float((jumps[0] + 1) / fps) if len(jumps) else None,
        held_share=float(lengths.sum() / len(squared)),
        frozen_seconds=float(lengths[most] / fps) if len(lengths) else 0.0,
        frozen_start_seconds=float(starts[most] / fps) if len(lengths) else None,
    )


def longest_steps(squared: Float32[np.ndarray, "steps joints"]) -> Float32[np.ndarray, "steps"]:
    """Longest step (m) of any joint between neighbouring frames; 0 where no joint moves by more than 1 µm."""
    longest: Float32[np.ndarray, steps] = np.sqrt(squared.max(axis=1))
    longest[longest <= SAME_METRES] = 0.0
    return longest


def jump_speed(fps: float) -> float:
    """By how much a step must be faster than its surroundings to be a jump, m/s."""
    return min(MAX_JUMP_SPEED, 2.0 * JUMP_ACCELERATION / fps)


def _jumps(lengths: Float32[np.ndarray, "steps joints"], fps: float) -> Int64[np.ndarray, "jumps"]:
    # Steps that some joint makes in a jump. A joint that jumps and comes back makes two long steps, so the steps that
    # they are compared with lie two away; of the outermost steps only one such is there.
    if len(lengths) < 5:
        return np.zeros(0, np.int64)
    excess = lengths.copy()
    excess[2:-2] -= np.maximum(lengths[:-4], lengths[4:])
    excess[:2] -= lengths[2:4]
    excess[-2:] -= lengths[-4:-2]
    return np.flatnonzero(excess.max(axis=1) * fps > jump_speed(fps))


def _runs(
    holds: Bool[np.ndarray, "steps"],
) -> tuple[Int64[np.ndarray, "runs"], Int64[np.ndarray, "runs"]]:
    # First step and number of steps of every run of steps for which it holds.
    edges = np.diff(np.concatenate(([0], holds.astype(np.int8), [0])))
    starts = np.flatnonzero(edges == 1)
    return starts, np.flatnonzero(edges == -1) - starts


def squared_differences(
    positions: Float32[np.ndarray, "rows joints 3"], order: int
) -> Float32[np.ndarray, "differences joints"]:
    """Squared lengths of the differences of an order in time; none where there are not more rows than that."""
    num_rows = max(0, len(positions) - order)
    squared = np.empty((num_rows, positions.shape[1]), np.float32)
    for start in range(0, num_rows, ROWS_AT_ONCE):
        vectors = np.diff(positions[start : start + ROWS_AT_ONCE + order], n=order, axis=0)
        squared[start : start + ROWS_AT_ONCE] = np.einsum("tjc,tjc->tj", vectors, vectors)
    return squared


# A bin lasts as long as a frame at 30 fps, the slowest rate of native capture: what happens between 30 bins a second is
# there in files of every rate above it, and nothing else is.
BINS_PER_SECOND = 30.0


def bin_means(values: Float32[np.ndarray, "frames *channels"], fps: float) -> Float32[np.ndarray, "bins *channels"]:
    """Means over bins of 1/30 s from the first frame on, each frame standing for 1/fps s; no bin is cut short."""
    frames_per_bin = fps / BINS_PER_SECOND
    if frames_per_bin == 1.0:
        return values
    # The last bin of a file at 29.97 fps may lack a hundredth of a frame.
    num_bins = int(len(values) / frames_per_bin + 0.01)
    edges = np.minimum(np.arange(num_bins + 1) * frames_per_bin, len(values))
    before = np.minimum(edges.astype(np.int64), len(values) - 1)
    into = (edges - before).astype(np.float32).reshape(-1, *(1,) * (values.ndim - 1))
    if not num_bins:
        return values[:0]
    # Whole frames from one edge to the next, without the part before the one and with the part before the other.
    cut = into * values[before]
    sums = np.add.reduceat(values, before, axis=0)[:-1]
    # A bin that begins where the next one does holds no whole frame (framerates under 30).
    sums[before[1:] == before[:-1]] = 0.0
    means = (sums - cut[:-1] + cut[1:]) / np.float32(frames_per_bin)
    return np.asarray(means)


# Below this framerate the bins of 1/30 s would hold interpolated values (29.97 fps is still measured).
MIN_FPS = 29.9
MIN_BINS = 8


def jitter(positions: Float32[np.ndarray, "frames joints 3"], fps: float) -> float | None:
    """Jerk that three quarters of all joints at all instants exceed, in m/s³; None below 29.9 fps or under 0.3 s.

    Jerk is the third difference of means over 1/30 s, so that the figure means the same from 30 fps upwards: raw
    differences grow with the cube of the framerate. Its lower quartile hardly rises with vigorous motion, which leaves
    some joints and instants calm, as noise does not.
    """
    if fps < MIN_FPS:
        return None
    bins = bin_means(positions, fps)
    if len(bins) < MIN_BINS:
        return None
    jerk_squared = squared_differences(bins, 3).ravel()
    quarter = len(jerk_squared) // 4
    return float(np.sqrt(np.partition(jerk_squared, quarter)[quarter]) * BINS_PER_SECOND**3)


def middle(values: Float[np.ndarray, "values"]) -> float:
    """As `np.median` for finite values, without its import of `numpy.ma`."""
    lower, upper = (len(values) - 1) // 2, len(values) // 2
    parted = np.partition(values, (lower, upper))
    return float((parted[lower] + parted[upper]) / 2)
