"""Input validation of the metrics."""

import numpy as np

from motionkit.core.shapes import Float, Float64


def checked_features(
    features: Float[np.ndarray, "samples features"], name: str, minimum: int
) -> Float64[np.ndarray, "samples features"]:
    """Features as float64; raises `ValueError` for other shapes, fewer than `minimum` samples, NaN or infinity."""
    if features.ndim != 2:
        raise ValueError(f"{name}: expected an array [samples, features], its shape is {features.shape}")
    if len(features) < minimum:
        raise ValueError(f"{name}: at least {minimum} samples are needed, there are {len(features)}")
    values = np.asarray(features, dtype=np.float64)
    finite = np.isfinite(values).all(axis=1)
    if not finite.all():
        raise ValueError(
            f"{name}: {int((~finite).sum())} of {len(values)} rows hold NaN or infinity, the first is row "
            f"{int(np.argmin(finite))}"
        )
    return values


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


def checked_quaternions(predicted: Float[np.ndarray, "*predicted 4"], target: Float[np.ndarray, "*target 4"]) -> None:
    """Raise `ValueError` if a quaternion does not have unit length."""
    for name, quaternions in (("predicted", predicted), ("target", target)):
        if not np.allclose(np.linalg.norm(quaternions, axis=-1), 1.0, atol=1e-3):
            raise ValueError(f"{name}: quaternions must have unit length")


def checked_fps(fps: float) -> float:
    """Return the framerate; raises `ValueError` if it is not positive and finite."""
    if not 0 < fps < np.inf:
        raise ValueError(f"fps must be positive and finite, not {fps}")
    return float(fps)
