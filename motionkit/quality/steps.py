"""What happens from one frame to the next: the fastest joint, jumps, and poses that do not change."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Int64

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
    """What the steps between frames say; speeds in m/s, times in seconds from the first frame.

    `first_jump_seconds` and `frozen_start_seconds` are None where there is no jump, and no two equal frames.
    `held_share` is the share of frames that are equal to the one before.
    """

    max_speed: float
    num_jumps: int
    first_jump_seconds: float | None
    held_share: float
    frozen_seconds: float
    frozen_start_seconds: float | None


def measure_steps(squared: Float32[np.ndarray, "steps joints"], fps: float) -> Steps:
    """What the squared lengths of every joint's steps (m²) between neighbouring frames say."""
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
