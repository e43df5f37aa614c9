"""The legs of a skeleton, and how they bend: the joints of each, and inverse kinematics of thigh and shank.

An ankle moves with the hip fixed and the lengths of thigh and shank kept. The knee stays in the leg's plane, rotated by
the minimum that the ankle's new direction needs; a straight leg, whose plane is undefined, bends forward. A leg is
never fully straightened: full reach is approached, not met.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from motionkit.core.kinematics import quaternion_between, quaternion_multiply, quaternion_rotate
from motionkit.core.shapes import Float, Float64
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.skeletons.mapping import SkeletonMapError
from motionkit.fields.transfer import counterpart_joints, subtree

Vectors = Float64[np.ndarray, "frames 3"]

SIDES = ("left", "right")
LONGEST_SHARE = 0.9995
LEAST_ROOM_METRES = 1e-4
BEND_METRES = 0.005
TINY = 1e-9


@dataclass(frozen=True)
class Leg:
    """Joints of one leg by index; `toe` is the ankle if the skeleton has no toe joint.

    `thigh`, `shank` and `foot` are the joints attached to each: from below the hip to the knee, from below the knee to
    the ankle, and everything below the ankle.
    """

    hip: int
    knee: int
    ankle: int
    toe: int
    thigh: tuple[int, ...]
    shank: tuple[int, ...]
    foot: tuple[int, ...]


@dataclass(frozen=True)
class Legs:
    """Both legs of a body."""

    left: Leg
    right: Leg

    @property
    def feet(self) -> tuple[int, int, int, int]:
        """Left ankle and toe, right ankle and toe."""
        return (self.left.ankle, self.left.toe, self.right.ankle, self.right.toe)

    def foot_paths(self, positions: Float[np.ndarray, "frames joints 3"]) -> Float[np.ndarray, "frames feet ends 3"]:
        """Positions of ankle and toe of both feet."""
        return positions[:, list(self.feet)].reshape(len(positions), 2, 2, 3)


@lru_cache(maxsize=256)
def legs_of(skeleton: Skeleton) -> Legs:
    """The legs of a skeleton that `motionkit.core.skeletons.mapping` knows.

    Raises `SkeletonMapError` for an unknown one, or if hips, knees and ankles are not in one chain.
    """
    own = {SMPL22.joint_names[joint]: source for joint, source in counterpart_joints(skeleton).items()}
    legs = [_leg(skeleton, own, side) for side in SIDES]
    return Legs(*legs)


def _leg(skeleton: Skeleton, own: dict[str, int], side: str) -> Leg:
    names = [f"{side}_{joint}" for joint in ("hip", "knee", "ankle")]
    missing = tuple(name for name in names if name not in own)
    if missing:
        raise SkeletonMapError(skeleton, SMPL22.name, missing)
    hip, knee, ankle = (own[name] for name in names)
    below = {joint: set(subtree(skeleton, joint)) - {joint} for joint in (hip, knee, ankle)}
    if knee not in below[hip] or ankle not in below[knee]:
        raise SkeletonMapError(skeleton, SMPL22.name, tuple(names))
    toe = own.get(f"{side}_foot", ankle)
    if toe not in below[ankle]:
        toe = ankle
    return Leg(
        hip,
        knee,
        ankle,
        toe,
        thigh=tuple(sorted(below[hip] - below[knee])),
        shank=tuple(sorted(below[knee] - below[ankle])),
        foot=tuple(sorted(below[ankle])),
    )


def bend(hip: Vectors, knee: Vectors, ankle: Vectors, target: Vectors, forward: Vectors) -> tuple[Vectors, Vectors]:
    """Knee and ankle for an ankle at `target`, or as close as it reaches; unchanged if the ankle is there already.

    `forward` is the horizontal facing direction of the body.
    """
    thigh, old, aim = knee - hip, ankle - hip, target - hip
    upper, lower = _length(thigh), _length(ankle - knee)
    old_reach, reach = _length(old), _length(aim)
    along, new_along = old / np.maximum(old_reach, TINY), aim / np.maximum(reach, TINY)
    reach = _reachable(old_reach, reach, upper, lower)
    side = thigh - along * _dot(thigh, along)
    # `forward` counts for a straight leg in proportion to the ankle's motion: not at all if it doesn't move.
    moved = np.square(_length(target - ankle))
    hint = BEND_METRES * moved / (moved + BEND_METRES**2)
    pole = side + hint * (forward - along * _dot(forward, along))
    pole = _turned(pole, along, new_along)
    pole /= np.maximum(_length(pole), TINY)
    share = (np.square(upper) - np.square(lower) + np.square(reach)) / (2.0 * np.maximum(reach, TINY))
    share = np.clip(share, -upper, upper)
    out = np.sqrt(np.maximum(np.square(upper) - np.square(share), 0.0))
    return hip + new_along * share + pole * out, hip + new_along * reach


def turns(
    hip: Vectors, knee: Vectors, ankle: Vectors, new_knee: Vectors, new_ankle: Vectors
) -> tuple[Float64[np.ndarray, "frames 4"], ...]:
    """World rotations of thigh and shank, with no twist other than their plane's."""
    swing = quaternion_between(ankle - hip, new_ankle - hip)
    found = []
    for old, new in ((knee - hip, new_knee - hip), (ankle - knee, new_ankle - new_knee)):
        found.append(quaternion_multiply(quaternion_between(quaternion_rotate(swing, old), new), swing))
    return tuple(found)


def _reachable(
    old: Float64[np.ndarray, "frames 1"],
    aim: Float64[np.ndarray, "frames 1"],
    upper: Float64[np.ndarray, "frames 1"],
    lower: Float64[np.ndarray, "frames 1"],
) -> Float64[np.ndarray, "frames 1"]:
    """The distance from hip to ankle: the target's, softly limited near the leg's full reach."""
    room = np.maximum(LONGEST_SHARE * (upper + lower) - old, LEAST_ROOM_METRES)
    farther = np.maximum(aim - old, 0.0) / room
    farther = room * farther / np.sqrt(np.sqrt(1.0 + np.square(np.square(farther))))
    nearest = np.abs(upper - lower) + LEAST_ROOM_METRES
    return np.asarray(np.maximum(np.minimum(aim, old) + farther, np.minimum(nearest, old)))


def _turned(vectors: Vectors, start: Vectors, stop: Vectors) -> Vectors:
    """Rotates vectors by the shortest rotation from one direction to another (Rodrigues, without angles)."""
    axis = np.cross(start, stop)
    cosine = _dot(start, stop)
    return np.asarray(
        vectors * cosine + np.cross(axis, vectors) + axis * (_dot(axis, vectors) / np.maximum(1.0 + cosine, TINY))
    )


def _dot(a: Vectors, b: Vectors) -> Float64[np.ndarray, "frames 1"]:
    return np.asarray(np.einsum("ni,ni->n", a, b)[:, None])


def _length(vectors: Vectors) -> Float64[np.ndarray, "frames 1"]:
    return np.asarray(np.sqrt(_dot(vectors, vectors)))
