"""Jitter: jerk that never lets up, in any joint."""

import numpy as np
from jaxtyping import Float32

from motionkit.quality.steps import squared_differences
from motionkit.quality.timescale import BINS_PER_SECOND, bin_means

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
