"""Bone-length drift: a body's bones do not change their lengths."""

import numpy as np
from jaxtyping import Float32

from motionkit.skeleton import Skeleton

# Lengths change slowly: 20 poses a second are enough. Shorter bones than this are points that lie on each other.
POSES_PER_SECOND = 20.0
MIN_BONE_METRES = 0.03


def bone_length_drift(
    positions: Float32[np.ndarray, "frames joints 3"], skeleton: Skeleton, fps: float
) -> float | None:
    """(longest − shortest) / mean length of the bone where that is largest; None without a bone of 3 cm.

    A joint that rests where its parent does has no bone: markers, which all hang from the first, move freely.
    """
    poses = positions[:: max(1, round(fps / POSES_PER_SECOND))]
    has_bone = np.any(skeleton.offsets != 0, axis=1).tolist()
    joints = np.array(
        [joint for joint, parent in enumerate(skeleton.parents) if parent >= 0 and has_bone[joint]], np.int64
    )
    bones = poses[:, joints] - poses[:, np.array(skeleton.parents, np.int64)[joints]]
    lengths = np.sqrt(np.einsum("tbc,tbc->tb", bones, bones))
    mean = lengths.mean(axis=0)
    known = mean >= MIN_BONE_METRES
    if not known.any():
        return None
    return float(((lengths.max(axis=0) - lengths.min(axis=0))[known] / mean[known]).max())
