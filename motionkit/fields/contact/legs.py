"""The legs of a skeleton: the joints that bend, and those rigidly attached to thigh, shank and foot."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from motionkit.core.shapes import Float
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.skeletons.mapping import SkeletonMapError
from motionkit.fields.transfer import counterpart_joints

SIDES = ("left", "right")


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
    below = {joint: _below(skeleton, joint) for joint in (hip, knee, ankle)}
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


def _below(skeleton: Skeleton, joint: int) -> frozenset[int]:
    found = {joint}
    for each, parent in enumerate(skeleton.parents):
        if parent in found:
            found.add(each)
    return frozenset(found - {joint})
