"""Means over bins of one fixed length in seconds: what is measured on them means the same at every framerate."""

import numpy as np
from jaxtyping import Float32

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
