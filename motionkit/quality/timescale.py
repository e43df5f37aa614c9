"""Means over bins of one fixed length in seconds: what is measured on them means the same at every framerate."""

import numpy as np
from jaxtyping import Float, Float64

# A bin lasts as long as a frame at 30 fps, the slowest rate of native capture: what happens between 30 bins a second is
# there in files of every rate above it, and nothing else is.
BINS_PER_SECOND = 30.0


def bin_means(values: Float[np.ndarray, "frames *channels"], fps: float) -> Float64[np.ndarray, "bins *channels"]:
    """Means over bins of 1/30 s from the first frame on, each frame standing for 1/fps s; no bin is cut short."""
    frames_per_bin = fps / BINS_PER_SECOND
    # The last bin of a file at 29.97 fps may lack a hundredth of a frame.
    num_bins = int(len(values) / frames_per_bin + 0.01)
    flat = values.reshape(len(values), -1)
    whole = np.zeros((len(values) + 1, flat.shape[1]))
    np.cumsum(flat, axis=0, dtype=np.float64, out=whole[1:])
    edges = np.minimum(np.arange(num_bins + 1) * frames_per_bin, len(values))
    before = np.minimum(edges.astype(np.int64), len(values) - 1)
    integral = whole[before] + (edges - before)[:, None] * flat[before]
    means: Float64[np.ndarray, "bins values"] = np.diff(integral, axis=0) / frames_per_bin
    return means.reshape(num_bins, *values.shape[1:])
