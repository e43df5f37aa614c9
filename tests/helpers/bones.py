"""Lengths of bones, from joint positions."""

import numpy as np

from motionkit.core.skeleton import Skeleton


def bone_lengths(positions: np.ndarray, skeleton: Skeleton) -> np.ndarray:
    """Distance of every joint but the root to its parent [..., joints - 1], in metres."""
    return np.asarray(np.linalg.norm(positions[..., 1:, :] - positions[..., skeleton.parents[1:], :], axis=-1))
