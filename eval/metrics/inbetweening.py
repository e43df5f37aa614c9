"""L2P and L2Q: in-betweening errors of whole poses, as the LaFAN1 benchmark defines them.

Both are norms over all numbers of a pose, averaged over frames and clips; neither is "per joint".
"""

import numpy as np

from eval.metrics.checks import checked_difference, checked_quaternions
from eval.metrics.metric import Metric, by_clip_frames
from motionkit.core.shapes import Float, Float64


def l2p(
    predicted: Float[np.ndarray, "clips frames joints 3"],
    target: Float[np.ndarray, "clips frames joints 3"],
    std: Float[np.ndarray, "joints 3"],
) -> float:
    """Mean over frames of √Σ((p̂ − p)/σ)² over all joints' global coordinates; no unit.

    `std` is that of the *training* windows' global positions, for each coordinate. Source: Harvey et al. 2020
    (ubisoft-laforge-animation-dataset).
    """
    if not (std > 0).all():
        raise ValueError("a standard deviation of the training positions is not positive")
    difference = checked_difference(predicted, target) / std
    return float(np.sqrt(np.square(difference).sum(axis=(-2, -1))).mean())


L2P = Metric("l2p", "L2P", "", False, "Harvey et al. 2020", "predicted, target", l2p, by_clip_frames)


def l2q(
    predicted: Float[np.ndarray, "clips frames joints 4"], target: Float[np.ndarray, "clips frames joints 4"]
) -> float:
    """Mean over frames of √Σ(q̂ − q)² over all joints' global quaternions, each with the sign nearer to the true one.

    q and −q are the same rotation: without aligned signs the value depends on how the quaternions were computed. Raises
    `ValueError` for quaternions that are not of unit length. Source: Harvey et al. 2020; signs as in delta-interpolator
    (Oreshkin et al. 2022).
    """
    difference = checked_difference(predicted, target)
    checked_quaternions(predicted, target)
    opposite = predicted.astype(np.float64) + target
    squared = np.minimum(np.square(difference).sum(axis=-1), np.square(opposite).sum(axis=-1))
    return float(np.sqrt(squared.sum(axis=-1)).mean())


L2Q = Metric("l2q", "L2Q", "", False, "Harvey et al. 2020", "predicted, target", l2q, by_clip_frames)


def l2q_as_signed(
    predicted: Float[np.ndarray, "clips frames joints 4"], target: Float[np.ndarray, "clips frames joints 4"]
) -> float:
    """`l2q` without aligning the signs: what the benchmark's own code computes.

    Signs should be continuous in each clip and start alike on both sides; a body that turns by more than half a turn is
    then farther from its first pose than by `l2q`. Source: Harvey et al. 2020.
    """
    difference = checked_difference(predicted, target)
    checked_quaternions(predicted, target)
    return float(np.sqrt(np.square(difference).sum(axis=(-2, -1))).mean())


L2Q_AS_SIGNED = Metric(
    "l2q_as_signed",
    "L2Q (signs as they come)",
    "",
    False,
    "Harvey et al. 2020",
    "predicted, target",
    l2q_as_signed,
    by_clip_frames,
)


def npss(
    predicted: Float[np.ndarray, "clips frames numbers"], target: Float[np.ndarray, "clips frames numbers"]
) -> float:
    """Distance of normalised power spectra over time, each number of each clip weighted by its true power; 0 is best.

    The distance is the L1 distance of cumulative spectra (an earth mover's distance). As in the LaFAN1 benchmark, power
    is the square of the **real part** of the Fourier coefficients, not of their modulus: figures are comparable only
    so, and depend on where a clip starts. A number without predicted power has a zero spectrum; one without true power
    has no weight. Raises `ValueError` if nothing has power. Source: Gopalakrishnan et al. 2019, §4.2.
    """
    checked_difference(predicted, target)
    true = _power(target)
    weights = true.sum(axis=1)
    total = weights.sum()
    if total == 0:
        raise ValueError("target has no power in any number: its normalised spectrum does not exist")
    distance = np.abs(_cumulative(_power(predicted)) - _cumulative(true)).sum(axis=1)
    return float((distance * weights).sum() / total)


def npss_weight(target: Float[np.ndarray, "clips frames numbers"]) -> float:
    """The total true power: the weight of a batch's NPSS in the NPSS of many batches of equal length."""
    return float(_power(target).sum())


NPSS = Metric(
    "npss",
    "NPSS",
    "",
    False,
    "Gopalakrishnan et al. 2019",
    "predicted, target",
    npss,
    lambda _, target: npss_weight(target),
)


def _power(signal: Float[np.ndarray, "clips frames numbers"]) -> Float64[np.ndarray, "clips frames numbers"]:
    return np.square(np.fft.fft(signal.astype(np.float64), axis=1).real)


def _cumulative(
    power: Float64[np.ndarray, "clips frames numbers"],
) -> Float64[np.ndarray, "clips frames numbers"]:
    total = power.sum(axis=1, keepdims=True)
    return np.asarray(np.cumsum(power / np.where(total > 0, total, 1.0), axis=1))
