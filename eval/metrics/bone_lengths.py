"""Bone-length consistency: a body's bones keep their lengths; a model of joint positions may not."""

import numpy as np
from jaxtyping import Float, Float64

from eval.metrics.checks import checked_features


def bone_length_variation(positions: Float[np.ndarray, "frames joints 3"], parents: tuple[int, ...]) -> float:
    """Mean over bones of (standard deviation over frames ÷ mean length), ddof 0, of one sequence; 0 for a rigid body.

    `parents` are indices of parent joints, −1 for the root. Bones of length zero (joints on their parent in every
    frame) don't count. Raises `ValueError` where no bone is left, for NaN or infinity. Defined here.
    """
    lengths = _lengths(positions, parents)
    mean = lengths.mean(axis=0)
    if not (mean > 0).any():
        raise ValueError("all joints lie on their parents: there is no bone to measure")
    return float((lengths.std(axis=0)[mean > 0] / mean[mean > 0]).mean())


def bone_length_error(
    predicted: Float[np.ndarray, "frames joints 3"],
    target: Float[np.ndarray, "frames joints 3"],
    parents: tuple[int, ...],
) -> float:
    """Mean absolute difference of predicted and true bone lengths over frames and bones, metres. Defined here."""
    if predicted.shape != target.shape:
        raise ValueError(f"predicted is {predicted.shape}, target is {target.shape}; they must agree")
    return float(np.abs(_lengths(predicted, parents) - _lengths(target, parents)).mean())


def _lengths(
    positions: Float[np.ndarray, "frames joints 3"], parents: tuple[int, ...]
) -> Float64[np.ndarray, "frames bones"]:
    if len(parents) != positions.shape[1]:
        raise ValueError(f"there are {positions.shape[1]} joints and {len(parents)} parents")
    joints = np.array([joint for joint, parent in enumerate(parents) if parent >= 0], dtype=np.int64)
    if not joints.size:
        raise ValueError("a skeleton of roots alone has no bones")
    values = checked_features(positions.reshape(len(positions), -1), "positions", minimum=1).reshape(positions.shape)
    return np.asarray(np.linalg.norm(values[:, joints] - values[:, np.array(parents)[joints]], axis=-1))
