"""Errors of velocity, acceleration and jerk, per second: what smoothing and jitter change and positions hardly show.

Arrays hold one sequence, or clips of one length along a first axis, each differentiated by itself.
"""

import numpy as np
from jaxtyping import Float

from eval.metrics.checks import checked_difference, checked_fps


def velocity_error(
    predicted: Float[np.ndarray, "*clips frames joints 3"],
    target: Float[np.ndarray, "*clips frames joints 3"],
    fps: float,
) -> float:
    """Mean distance between predicted and true joint velocities, m/s."""
    return _derivative_error(predicted, target, fps, order=1)


def acceleration_error(
    predicted: Float[np.ndarray, "*clips frames joints 3"],
    target: Float[np.ndarray, "*clips frames joints 3"],
    fps: float,
) -> float:
    """Mean distance between predicted and true joint accelerations, m/s² ("Accel": Kanazawa et al. 2019)."""
    return _derivative_error(predicted, target, fps, order=2)


def jerk_error(
    predicted: Float[np.ndarray, "*clips frames joints 3"],
    target: Float[np.ndarray, "*clips frames joints 3"],
    fps: float,
) -> float:
    """Mean distance between predicted and true joint jerks, m/s³."""
    return _derivative_error(predicted, target, fps, order=3)


def _derivative_error(
    predicted: Float[np.ndarray, "*clips frames joints 3"],
    target: Float[np.ndarray, "*clips frames joints 3"],
    fps: float,
    *,
    order: int,
) -> float:
    # Differences across the seam of two sequences would count as motion, so clips have an axis of their own. They are
    # linear: the difference of derivatives is the derivative of the difference.
    difference = checked_difference(predicted, target)
    num_frames = difference.shape[-3]
    if num_frames <= order:
        raise ValueError(f"a derivative of order {order} needs at least {order + 1} frames, not {num_frames}")
    derivative = np.diff(difference, n=order, axis=-3) * checked_fps(fps) ** order
    return float(np.linalg.norm(derivative, axis=-1).mean())
