"""Errors of motions: positions, angles, pose vectors, bones, derivatives; in-betweening; PSNR and SSIM; feet.

Arrays hold valid frames only, of one sequence or of many concatenated, or clips where a function says so; every frame
has the same weight. Axes are y up, lengths metres, velocities per second.
"""

import math
from functools import partial

import numpy as np

from eval.metrics.distributions import checked_features
from eval.metrics.metric import Metric, by_clips, by_frames, by_steps
from motionkit.core.shapes import Bool, Float, Float64

Positions = Float[np.ndarray, "*clips frames joints 3"]
Quaternions = Float[np.ndarray, "*clips frames joints 4"]
Vectors = Float[np.ndarray, "*clips frames numbers"]


def checked_difference(
    predicted: Float[np.ndarray, "*predicted"], target: Float[np.ndarray, "*target"]
) -> Float64[np.ndarray, "*predicted"]:
    """predicted − target in float64; raises `ValueError` for unequal shapes, nothing to compare, NaN or infinity."""
    if predicted.shape != target.shape:
        raise ValueError(f"predicted is {predicted.shape}, target is {target.shape}; they must agree")
    if not predicted.size:
        raise ValueError("there are no frames to compare")
    difference: Float64[np.ndarray, "*predicted"] = predicted.astype(np.float64) - target
    if not np.isfinite(difference).all():
        raise ValueError("predicted or target holds NaN or infinity")
    return difference


def checked_rotations(predicted: Quaternions, target: Quaternions) -> Float64[np.ndarray, "*clips frames joints 4"]:
    """`checked_difference` of unit quaternions; raises `ValueError` for other lengths too."""
    for name, quaternions in (("predicted", predicted), ("target", target)):
        if not np.allclose(np.linalg.norm(quaternions, axis=-1), 1.0, atol=1e-3):
            raise ValueError(f"{name}: quaternions must have unit length")
    return checked_difference(predicted, target)


def checked_fps(fps: float) -> float:
    """Return the framerate; raises `ValueError` if it is not positive and finite."""
    if not 0 < fps < np.inf:
        raise ValueError(f"fps must be positive and finite, not {fps}")
    return float(fps)


def mpjpe_global(predicted: Positions, target: Positions) -> float:
    """Mean distance between predicted and true joints in metres, in global coordinates."""
    difference = checked_difference(predicted, target)
    return float(np.linalg.norm(difference, axis=-1).mean())


def mpjpe_root_aligned(predicted: Positions, target: Positions, root: int = 0) -> float:
    """Mean distance in metres with every frame's root aligned to the true one (the root itself is included, as 0).

    This is what motion-latent-diffusion and the NeRM paper's Table 4 call MPJPE.
    """
    difference = checked_difference(predicted, target)
    difference -= difference[:, root : root + 1].copy()
    return float(np.linalg.norm(difference, axis=-1).mean())


def mpjpe_procrustes(predicted: Positions, target: Positions) -> float:
    """Mean distance in metres after aligning rotation, translation and scale of every frame (PA-MPJPE; Gower 1975)."""
    checked_difference(predicted, target)
    x, y = predicted.astype(np.float64), target.astype(np.float64)
    x -= x.mean(axis=1, keepdims=True)
    y -= y.mean(axis=1, keepdims=True)
    u, singular, vt = np.linalg.svd(np.swapaxes(x, 1, 2) @ y)
    signs = np.ones_like(singular)
    signs[:, 2] = np.sign(np.linalg.det(u @ vt))
    rotation = (u * signs[:, None]) @ vt
    size = np.einsum("fji,fji->f", x, x)
    scale = np.where(size > 0, (singular * signs).sum(axis=1) / np.where(size > 0, size, 1.0), 1.0)
    return float(np.linalg.norm(scale[:, None, None] * (x @ rotation) - y, axis=-1).mean())


def rotation_angle_error(predicted: Quaternions, target: Quaternions) -> float:
    """Mean geodesic distance in degrees between predicted and true joint rotations.

    Unit quaternions of either sign, local or global on both sides. Raises `ValueError` for others.
    """
    checked_rotations(predicted, target)
    p, q = predicted.astype(np.float64), target.astype(np.float64)
    # ‖p − q‖ and ‖p + q‖ are 2·sin and 2·cos of a quarter of the angle: exact for small angles, where arccos is not.
    apart, together = np.linalg.norm(p - q, axis=-1), np.linalg.norm(p + q, axis=-1)
    quarter = np.arctan2(np.minimum(apart, together), np.maximum(apart, together))
    return float(np.degrees(4.0 * quarter).mean())


def mre(predicted: Vectors, target: Vectors) -> float:
    """Root-mean-square difference over all numbers of the redundant pose vectors, in their raw units.

    The NeRM paper defines MRE as the Euclidean distance between two pose vectors, but its 0.041 beside an MPJPE of
    0.016 cannot be that norm; `mean_vector_distance` is the literal definition.
    """
    difference = checked_difference(predicted, target)
    return float(np.sqrt(np.mean(difference * difference)))


def mean_vector_distance(predicted: Vectors, target: Vectors) -> float:
    """Mean Euclidean distance between pose vectors: MRE as the paper describes it (L2 norm, raw units)."""
    return float(np.linalg.norm(checked_difference(predicted, target), axis=-1).mean())


def derivative_error(predicted: Positions, target: Positions, fps: float, *, order: int) -> float:
    """Mean distance of the joints' derivatives of this order: m/s, m/s² ("Accel": Kanazawa et al. 2019), m/s³.

    Clips have an axis of their own, so that no difference crosses two sequences.
    """
    # Differences are linear: the difference of derivatives is the derivative of the difference.
    difference = checked_difference(predicted, target)
    num_frames = difference.shape[-3]
    if num_frames <= order:
        raise ValueError(f"a derivative of order {order} needs at least {order + 1} frames, not {num_frames}")
    derivative = np.diff(difference, n=order, axis=-3) * checked_fps(fps) ** order
    return float(np.linalg.norm(derivative, axis=-1).mean())


def l2p(predicted: Positions, target: Positions, std: Float[np.ndarray, "joints 3"]) -> float:
    """Mean over frames of √Σ((p̂ − p)/σ)² over all joints' global coordinates; no unit.

    `std` is that of the *training* windows' global positions, for each coordinate. Source: Harvey et al. 2020
    (ubisoft-laforge-animation-dataset).
    """
    if not (std > 0).all():
        raise ValueError("a standard deviation of the training positions is not positive")
    difference = checked_difference(predicted, target) / std
    return float(np.sqrt(np.square(difference).sum(axis=(-2, -1))).mean())


def l2q(predicted: Quaternions, target: Quaternions, *, align_signs: bool = True) -> float:
    """Mean over frames of √Σ(q̂ − q)² over all joints' global quaternions, each with the sign nearer to the true one.

    q and −q are the same rotation: without aligned signs the value depends on how the quaternions were computed. The
    benchmark's own code does not align them (`align_signs=False`): signs should then be continuous in each clip and
    start alike on both sides, and a body that turns by more than half a turn is farther from its first pose. Raises
    `ValueError` for quaternions that are not of unit length. Source: Harvey et al. 2020; signs: Oreshkin et al. 2022.
    """
    squared = np.square(checked_rotations(predicted, target)).sum(axis=-1)
    if align_signs:
        squared = np.minimum(squared, np.square(predicted.astype(np.float64) + target).sum(axis=-1))
    return float(np.sqrt(squared.sum(axis=-1)).mean())


def npss(predicted: Vectors, target: Vectors) -> float:
    """Distance of normalised power spectra over time, each number of each clip weighted by its true power; 0 is best.

    The distance is the L1 distance of cumulative spectra (an earth mover's distance). As in the LaFAN1 benchmark, power
    is the square of the **real part** of the Fourier coefficients, not of their modulus: figures are comparable only
    so, and depend on where a clip starts. A number without predicted power has a zero spectrum; one without true power
    has no weight; of batches of equal length, each weighs by its true power. Raises `ValueError` if nothing has power.
    Source: Gopalakrishnan et al. 2019, §4.2.
    """
    checked_difference(predicted, target)
    true = _power(target)
    weights = true.sum(axis=1)
    total = weights.sum()
    if total == 0:
        raise ValueError("target has no power in any number: its normalised spectrum does not exist")
    distance = np.abs(_cumulative(_power(predicted)) - _cumulative(true)).sum(axis=1)
    return float((distance * weights).sum() / total)


def _power(signal: Vectors) -> Float64[np.ndarray, "*clips frames numbers"]:
    return np.square(np.fft.fft(signal.astype(np.float64), axis=1).real)


def _cumulative(power: Float64[np.ndarray, "*clips frames numbers"]) -> Float64[np.ndarray, "*clips frames numbers"]:
    total = power.sum(axis=1, keepdims=True)
    return np.asarray(np.cumsum(power / np.where(total > 0, total, 1.0), axis=1))


SSIM_WINDOW = 7
_C1, _C2 = 0.01**2, 0.03**2


def psnr(
    predicted: Vectors, target: Vectors, synthesised: Bool[np.ndarray, "marks"], ceiling_db: float = math.inf
) -> float:
    """−10·log₁₀ of the mean squared error of a clip in the unit range, dB, over its synthesised frames alone.

    Given frames have no error by definition and would raise the value. For several clips with the same frames given,
    the mean of their dB. Infinite for a clip without error, unless clips are capped at `ceiling_db`.
    """
    if not synthesised.any():
        raise ValueError("no frame is synthesised: there is nothing to measure")
    difference = checked_difference(predicted, target)[..., synthesised, :]
    error = np.mean(difference * difference, axis=(-2, -1))
    with np.errstate(divide="ignore"):
        return float(np.mean(np.minimum(-10.0 * np.log10(error), ceiling_db)))


def ssim(predicted: Vectors, target: Vectors) -> float:
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


def _window_means(
    signal: Float64[np.ndarray, "*clips frames numbers"],
) -> Float64[np.ndarray, "*clips windows numbers"]:
    from scipy.ndimage import uniform_filter1d

    half = SSIM_WINDOW // 2
    means: Float64[np.ndarray, "*clips windows numbers"] = uniform_filter1d(signal, SSIM_WINDOW, axis=-2)
    return means[..., half:-half, :]


FOOT_HEIGHTS = (0.08, 0.04, 0.08, 0.04)


def skating_speed(feet: Float[np.ndarray, "frames 4 3"], fps: float, *, floor: float = 0.0) -> float:
    """Mean of v·(2 − 2^clamp(h/H, 0, 1)) over frames, ankles and toes, m/s: lower feet have more weight.

    The joints are left ankle and toe, then the right ones; H is 8 cm for ankles and 4 cm for toes; v is horizontal
    speed from a frame to the next, h the height at the first of the two. Source: Zhang et al. 2018, as in NeMF.
    """
    values = checked_features(feet.reshape(len(feet), -1), "feet", minimum=2).reshape(-1, len(FOOT_HEIGHTS), 3)
    steps = np.diff(values[..., ::2], axis=0)
    speed = np.hypot(steps[..., 0], steps[..., 1]) * checked_fps(fps)
    height = (values[:-1, :, 1] - floor) / FOOT_HEIGHTS
    return float((speed * (2.0 - np.exp2(np.clip(height, 0.0, 1.0)))).mean())


_HARVEY, _KANAZAWA, _GEODESIC = "Harvey et al. 2020", "Kanazawa et al. 2019", "geodesic distance on SO(3)"
_FIRST, _THIRD = "mean joint distance of differences", "mean joint distance of third differences"
_VELOCITY, _ACCELERATION, _JERK = (partial(derivative_error, order=order) for order in (1, 2, 3))
_SIGNED = partial(l2q, align_signs=False)
METRICS = (
    Metric("mpjpe_global", "MPJPE (global)", "m", False, "Ionescu et al. 2014", mpjpe_global, by_frames),
    Metric("mpjpe", "MPJPE", "m", False, "motion-latent-diffusion; NeRM Table 4", mpjpe_root_aligned, by_frames),
    Metric("mpjpe_procrustes", "MPJPE (Procrustes)", "m", False, "Gower 1975", mpjpe_procrustes, by_frames),
    Metric("rotation_angle_error", "Rotation error", "°", False, _GEODESIC, rotation_angle_error, by_frames),
    Metric("mre", "MRE", "raw", False, "NeRM Table 4, as a root mean square", mre, by_frames, exponent=2),
    Metric("mean_vector_distance", "MRE (L2 norm)", "raw", False, "NeRM Table 4", mean_vector_distance, by_frames),
    Metric("velocity_error", "Velocity error", "m/s", False, _FIRST, _VELOCITY, by_steps(1)),
    Metric("acceleration_error", "Acceleration error", "m/s²", False, _KANAZAWA, _ACCELERATION, by_steps(2)),
    Metric("jerk_error", "Jerk error", "m/s³", False, _THIRD, _JERK, by_steps(3)),
    Metric("l2p", "L2P", "", False, _HARVEY, l2p, by_steps(0)),
    Metric("l2q", "L2Q", "", False, _HARVEY, l2q, by_steps(0)),
    Metric("l2q_as_signed", "L2Q (signs as they come)", "", False, _HARVEY, _SIGNED, by_steps(0)),
    Metric("npss", "NPSS", "", False, "Gopalakrishnan et al. 2019", npss, lambda _, true: float(_power(true).sum())),
    Metric("psnr", "PSNR", "dB", True, "motionkit", psnr, by_clips),
    Metric("ssim", "SSIM", "", True, "Wang et al. 2004", ssim, by_clips),
    Metric("skating_speed", "Foot skating", "m/s", False, "Zhang et al. 2018; NeMF", skating_speed, by_steps(1)),
)
