"""PSNR and SSIM of motion: pose vectors as one-dimensional signals, scaled to a range of 1.

There is no precedent for either on motion; this definition is motionkit's own (docs/metrics.md).
"""

import math

import numpy as np
from jaxtyping import Bool, Float, Float64

from eval.metrics.checks import checked_difference, checked_features

SSIM_WINDOW = 7
_C1, _C2 = 0.01**2, 0.03**2


def to_unit_range(
    vectors: Float[np.ndarray, "frames numbers"],
    mean: Float[np.ndarray, "numbers"],
    std: Float[np.ndarray, "numbers"],
) -> Float64[np.ndarray, "frames numbers"]:
    """0.5 + (x − μ)/(4σ), not clipped: ± 2 standard deviations of the *training* data span the range of 1.

    σ must have been floored for each group of features; raises `ValueError` where it is not positive.
    """
    if not (std > 0).all():
        raise ValueError("a standard deviation is not positive: floor it for each group of features")
    return np.asarray(0.5 + (vectors.astype(np.float64) - mean) / (4.0 * std))


def psnr(
    predicted: Float[np.ndarray, "frames numbers"],
    target: Float[np.ndarray, "frames numbers"],
    synthesised: Bool[np.ndarray, "marks"],
) -> float:
    """−10·log₁₀ of the mean squared error of a clip in the unit range, dB, over its synthesised frames alone.

    Given frames are right by definition: counted, they would raise the figure with the share of them. Infinite where
    nothing differs. Average over clips, not over frames.
    """
    if synthesised.shape != (len(predicted),):
        raise ValueError(f"there are {len(predicted)} frames and {len(synthesised)} marks of synthesised ones")
    difference = checked_difference(predicted, target)[synthesised]
    if not difference.size:
        raise ValueError("no frame is synthesised: there is nothing to measure")
    error = float(np.mean(difference * difference))
    return -10.0 * math.log10(error) if error > 0 else math.inf


def ssim(predicted: Float[np.ndarray, "frames numbers"], target: Float[np.ndarray, "frames numbers"]) -> float:
    """Structural similarity of a clip in the unit range: windows of 7 frames of each number, mean over all.

    Uniform windows that lie wholly inside the clip, sample (N − 1) variances, K₁ = 0.01, K₂ = 0.03: what scikit-image
    computes with win_size 7, data_range 1, channel_axis −1. At most 1, which identical clips have; symmetric.
    Raises `ValueError` for clips of fewer than 7 frames. Source: Wang et al. 2004.
    """
    checked_difference(predicted, target)
    x, y = (
        np.lib.stride_tricks.sliding_window_view(
            checked_features(signal, "clip", minimum=SSIM_WINDOW), SSIM_WINDOW, axis=0
        )
        for signal in (predicted, target)
    )
    mean_x, mean_y = x.mean(axis=-1), y.mean(axis=-1)
    centred_x, centred_y = x - mean_x[..., None], y - mean_y[..., None]
    degrees = SSIM_WINDOW - 1
    variances = (np.square(centred_x) + np.square(centred_y)).sum(axis=-1) / degrees
    covariance = (centred_x * centred_y).sum(axis=-1) / degrees
    similarity = (2 * mean_x * mean_y + _C1) * (2 * covariance + _C2)
    similarity /= (mean_x**2 + mean_y**2 + _C1) * (variances + _C2)
    return float(similarity.mean())
