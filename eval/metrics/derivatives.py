"""Errors of velocity, acceleration and jerk, per second: what smoothing and jitter change and positions hardly show."""

import numpy as np
from jaxtyping import Float

from eval.metrics.checks import checked_difference, checked_fps


def velocity_error(
    predicted: Float[np.ndarray, "frames joints 3"], target: Float[np.ndarray, "frames joints 3"], fps: float
) -> float:
    """Mean distance between predicted and true joint velocities, m/s."""
    return _derivative_error(predicted, target, fps, order=1)


def acceleration_error(
    predicted: Float[np.ndarray, "frames joints 3"], target: Float[np.ndarray, "frames joints 3"], fps: float
) -> float:
    """Mean distance between predicted and true joint accelerations, m/s² ("Accel": Kanazawa et al. 2019)."""
    return _derivative_error(predicted, target, fps, order=2)


def jerk_error(
    predicted: Float[np.ndarray, "frames joints 3"], target: Float[np.ndarray, "frames joints 3"], fps: float
) -> float:
    """Mean distance between predicted and true joint jerks, m/s³."""
    return _derivative_error(predicted, target, fps, order=3)


def _derivative_error(
    predicted: Float[np.ndarray, "frames joints 3"],
    target: Float[np.ndarray, "frames joints 3"],
    fps: float,
    *,
    order: int,
) -> float:
    # One sequence, in metres: differences across the seam of two sequences would count as motion. Differences are
    # linear, so the difference of derivatives is the derivative of the difference.
    difference = checked_difference(predicted, target)
    if len(difference) <= order:
        raise ValueError(f"a derivative of order {order} needs at least {order + 1} frames, not {len(difference)}")
    derivative = np.diff(difference, n=order, axis=0) * checked_fps(fps) ** order
    return float(np.linalg.norm(derivative, axis=-1).mean())
