"""PSNR and SSIM of motion: pose vectors as one-dimensional signals, scaled to a range of 1.

Neither has a published definition for motion; this one is motionkit's own (docs/metrics.md).
"""

import math

import numpy as np

from eval.metrics.checks import checked_difference
from eval.metrics.metric import Metric, by_clips
from motionkit.core.shapes import Bool, Float, Float64

SSIM_WINDOW = 7
_C1, _C2 = 0.01**2, 0.03**2


def to_unit_range(
    vectors: Float[np.ndarray, "*frames numbers"],
    mean: Float[np.ndarray, "numbers"],
    std: Float[np.ndarray, "numbers"],
) -> Float64[np.ndarray, "*frames numbers"]:
    """0.5 + (x − μ)/(4σ), not clipped: ± 2 standard deviations of the *training* data span the range of 1.

    σ must have been floored for each group of features; raises `ValueError` if it is not positive.
    """
    if not (std > 0).all():
        raise ValueError("a standard deviation is not positive: floor it for each group of features")
    return np.asarray(0.5 + (vectors.astype(np.float64) - mean) / (4.0 * std))


def psnr(
    predicted: Float[np.ndarray, "*clips frames numbers"],
    target: Float[np.ndarray, "*clips frames numbers"],
    synthesised: Bool[np.ndarray, "marks"],
    ceiling_db: float = math.inf,
) -> float:
    """−10·log₁₀ of the mean squared error of a clip in the unit range, dB, over its synthesised frames alone.

    Given frames have no error by definition and would raise the value. For several clips with the same frames given,
    the mean of their dB. Infinite for a clip without error, unless clips are capped at `ceiling_db`.
    """
    num_frames = predicted.shape[-2]
    if synthesised.shape != (num_frames,):
        raise ValueError(f"there are {num_frames} frames and {len(synthesised)} marks of synthesised ones")
    if not synthesised.any():
        raise ValueError("no frame is synthesised: there is nothing to measure")
    difference = checked_difference(predicted, target)[..., synthesised, :]
    error = np.mean(difference * difference, axis=(-2, -1))
    with np.errstate(divide="ignore"):
        return float(np.mean(np.minimum(-10.0 * np.log10(error), ceiling_db)))


PSNR = Metric("psnr", "PSNR", "dB", True, "motionkit", "predicted, target", psnr, by_clips)


def ssim(
    predicted: Float[np.ndarray, "*clips frames numbers"], target: Float[np.ndarray, "*clips frames numbers"]
) -> float:
    """Structural similarity of a clip in the unit range: windows of 7 frames of each number, mean over all.

    Uniform windows wholly inside the clip, sample (N − 1) variances, K₁ = 0.01, K₂ = 0.03: what scikit-image computes
    with win_size 7, data_range 1, channel_axis −1; of several clips of one length, the mean. At most 1, for identical
    clips; symmetric. Raises `ValueError` for clips of fewer than 7 frames. Source: Wang et al. 2004.
    """
    checked_difference(predicted, target)
    if predicted.shape[-2] < SSIM_WINDOW:
        raise ValueError(f"clip: at least {SSIM_WINDOW} samples are needed, there are {predicted.shape[-2]}")
    x, y = predicted.astype(np.float64), target.astype(np.float64)
    mean_x, mean_y = _window_means(x), _window_means(y)
    # n/(n − 1)·(E[xy] − E[x]E[y]): exact to about 1e-15 in a range of 1, where _C2 is 1e-3.
    unbiased = SSIM_WINDOW / (SSIM_WINDOW - 1)
    product, squares = mean_x * mean_y, mean_x * mean_x + mean_y * mean_y
    covariance = unbiased * (_window_means(x * y) - product)
    variances = unbiased * (_window_means(x * x + y * y) - squares)
    similarity = (2 * product + _C1) * (2 * covariance + _C2)
    similarity /= (squares + _C1) * (variances + _C2)
    return float(similarity.mean())


SSIM = Metric("ssim", "SSIM", "", True, "Wang et al. 2004", "predicted, target", ssim, by_clips)


def _window_means(
    signal: Float64[np.ndarray, "*clips frames numbers"],
) -> Float64[np.ndarray, "*clips windows numbers"]:
    num_windows = signal.shape[-2] - SSIM_WINDOW + 1
    total = signal[..., :num_windows, :].copy()
    for first in range(1, SSIM_WINDOW):
        total += signal[..., first : first + num_windows, :]
    total /= SSIM_WINDOW
    return total
