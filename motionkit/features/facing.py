"""Where a body faces over time, smoothed."""

from functools import lru_cache

import numpy as np
from jaxtyping import Float, Float64

_TRUNCATE = 4.0


def smooth(values: Float[np.ndarray, "frames columns"], sigma_frames: float) -> Float64[np.ndarray, "frames columns"]:
    """Gaussian smoothing along time; beyond both ends the end values go on.

    The kernel is sampled at whole frames and cut at 4σ, as `scipy.ndimage.gaussian_filter1d(mode="nearest")` does.
    """
    kernel = _kernel(sigma_frames)
    reach = len(kernel) // 2
    padded = np.empty((values.shape[1], len(values) + 2 * reach))
    padded[:, reach : reach + len(values)] = values.T
    padded[:, :reach], padded[:, reach + len(values) :] = values[0, :, None], values[-1, :, None]
    return np.stack([_convolve(column, kernel) for column in padded], axis=-1)


@lru_cache(maxsize=64)
def _kernel(sigma_frames: float) -> Float64[np.ndarray, "taps"]:
    reach = int(_TRUNCATE * sigma_frames + 0.5)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma_frames) ** 2)
    kernel /= kernel.sum()
    kernel.flags.writeable = False
    return np.asarray(kernel)


def _convolve(
    padded: Float64[np.ndarray, "padded"], kernel: Float64[np.ndarray, "taps"]
) -> Float64[np.ndarray, "frames"]:
    if len(kernel) * len(padded) < 1_000_000:
        return np.convolve(padded, kernel, mode="valid")
    from scipy.signal import oaconvolve

    return np.asarray(oaconvolve(padded, kernel, mode="valid"))


def to_z_half_angle(direction: Float[np.ndarray, "frames 2"]) -> Float64[np.ndarray, "frames"]:
    """Half the angle about Y, in (−π/2, π/2], that turns each horizontal direction (x, z) to Z+."""
    return np.asarray(0.5 * np.arctan2(-direction[:, 0], direction[:, 1]), dtype=np.float64)
