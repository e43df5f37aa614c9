"""Implausible bodies: bones that change their length, feet that slide while in contact, bodies that never stand."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.skeletons.mapping import SkeletonMapError, body_axis, joint_map
from motionkit.features.quality.steps import BINS_PER_SECOND, bin_means, middle

# Lengths and posture change slowly: 20 poses a second are enough. Shorter bones than this are points that lie on each
# other.
POSES_PER_SECOND = 20.0
MIN_BONE_METRES = 0.03


def bone_length_drift(
    positions: Float32[np.ndarray, "frames joints 3"], skeleton: Skeleton, fps: float
) -> float | None:
    """The maximum over bones of (longest − shortest) / mean length; None without a bone of 3 cm.

    A joint with a zero rest offset has no bone: markers, which are all children of the first, move freely.
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


def head_elevation(positions: Float32[np.ndarray, "frames joints 3"], skeleton: Skeleton, fps: float) -> float | None:
    """The sine of the angle at which the head is above the feet, its 95 % quantile; None for unknown joints.

    It is near 1 for a body that stands for a twentieth of the time, near 0 for one that lies or crawls throughout.
    """
    try:
        vectors = body_axis(skeleton, positions[:: max(1, round(fps / POSES_PER_SECOND))])
    except SkeletonMapError:
        return None
    lengths = np.linalg.norm(vectors, axis=-1)
    has_length = lengths >= MIN_BONE_METRES
    sines = np.sort(vectors[has_length, 1] / lengths[has_length])
    return float(sines[round(0.95 * (len(sines) - 1))]) if len(sines) else None


FOOT_JOINTS = ("left_ankle", "left_foot", "right_ankle", "right_foot")
# A joint of the foot is on the ground while it is within 2 cm of its own lowest level, which is taken from the take
# because floors are off and an ankle stands higher than a toe. Within 5 cm (CondMDI's height) feet of runners swing.
GROUND_METRES = 0.02
GROUND_QUANTILE = 0.05
# A slide is measured over 0.1 s: at a standstill, half a millimetre of noise is 60 mm/s from frame to frame at 120 fps.
SLIDE_BINS = 3
SLIDING_SPEED = 0.25
MIN_GROUNDED = 15


@dataclass(frozen=True)
class FootSkate:
    """Median speed of the steadiest foot joint on the ground, m/s, and the share of that time in which it slides."""

    speed: float
    share: float


def foot_skate(motion: Motion) -> FootSkate | None:
    """How a motion's feet slide; None if its skeleton has no known feet, or these are on the ground for under 0.5 s.

    While a body stands, walks or runs, one joint of the feet on the ground rests: the steadiest of them is measured.
    Instants are those of bins of 1/30 s, so that the figure means the same at every framerate.
    """
    rows = _foot_rows(motion.skeleton)
    if rows is None:
        return None
    feet = np.stack([_weighted(motion.joint_positions, row) for row in rows], axis=1)
    bins = bin_means(feet, float(motion.fps))
    if len(bins) <= SLIDE_BINS:
        return None
    height = bins[..., 1]
    rank = int(GROUND_QUANTILE * (len(bins) - 1))
    low = height <= np.partition(height, rank, axis=0)[rank] + GROUND_METRES
    slide = bins[SLIDE_BINS:, :, ::2] - bins[:-SLIDE_BINS, :, ::2]
    speed = np.hypot(slide[..., 0], slide[..., 1]) * (BINS_PER_SECOND / SLIDE_BINS)
    stays = np.logical_and.reduce([low[first : first + len(speed)] for first in range(SLIDE_BINS + 1)])
    steadiest = np.where(stays, speed, np.inf).min(axis=1)
    grounded = steadiest[np.isfinite(steadiest)]
    if len(grounded) < MIN_GROUNDED:
        return None
    return FootSkate(middle(grounded), float(np.mean(grounded > SLIDING_SPEED)))


def _weighted(
    positions: Float32[np.ndarray, "frames joints 3"], row: tuple[tuple[int, float], ...]
) -> Float32[np.ndarray, "frames 3"]:
    (first, weight), *others = row
    total = positions[:, first] * np.float32(weight)
    for joint, other in others:
        total += positions[:, joint] * np.float32(other)
    return total


@lru_cache(maxsize=1024)
def _foot_rows(skeleton: Skeleton) -> tuple[tuple[tuple[int, float], ...], ...] | None:
    # The foot joints that a skeleton has, as weighted sums of its own; made-up toes and unnamed tips are left out.
    try:
        mapping = joint_map(skeleton, SMPL22.name)
    except SkeletonMapError:
        return None
    rows = []
    for name in FOOT_JOINTS:
        joint = SMPL22.index(name)
        if name not in mapping.made_up and not mapping.tip_weights[joint].any():
            used = np.flatnonzero(mapping.weights[joint])
            rows.append(tuple((int(source), float(mapping.weights[joint, source])) for source in used))
    return tuple(rows)
