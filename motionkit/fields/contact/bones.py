"""The body that is planted: its legs and how they bend, and joint positions projected onto constant bone lengths.

An ankle moves with the hip fixed and the lengths of thigh and shank kept. The knee stays in the leg's plane, rotated by
the minimum that the ankle's new direction needs; a straight leg, whose plane is undefined, bends forward. A leg is
never fully straightened: full reach is approached, not met.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from motionkit.core.kinematics import (
    fit_rotation,
    quaternion_between,
    quaternion_conjugate,
    quaternion_multiply,
    quaternion_rotate,
)
from motionkit.core.shapes import Float, Float32, Float64
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.skeletons.mapping import SkeletonMapError, counterpart_joints

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
    below = {joint: set(skeleton.subtree(joint)) - {joint} for joint in (hip, knee, ankle)}
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
    upper, lower = _lengths(thigh)[:, None], _lengths(ankle - knee)[:, None]
    old_reach, reach = _lengths(old)[:, None], _lengths(aim)[:, None]
    along, new_along = old / np.maximum(old_reach, TINY), aim / np.maximum(reach, TINY)
    reach = _reachable(old_reach, reach, upper, lower)
    side = _across(thigh, along)
    # `forward` counts for a straight leg in proportion to the ankle's motion: not at all if it doesn't move.
    moved = np.square(_lengths(target - ankle)[:, None])
    hint = BEND_METRES * moved / (moved + BEND_METRES**2)
    pole = side + hint * _across(forward, along)
    pole = quaternion_rotate(quaternion_between(along, new_along), pole)
    pole /= np.maximum(_lengths(pole)[:, None], TINY)
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


# If a joint's distance from its parent varies by more, there is no bone: hips above a reference on the floor, markers.
TRAVELLING_FROM_ROOT_METRES, TRAVELLING_METRES = 0.25, 0.5
NO_LENGTH = 1e-6
CAPTURED_SHARE, CAPTURED_METRES = 0.05, 0.003
"""Tolerated variation of bone lengths in captures."""
ROUNDING_METRES = 1e-4
LIMB_RATIO = 0.4
"""Smallest length ratio of the two bones of a limb: arms and legs, not ankle and toe."""
SHRUNK_SHARE, GONE_SHARE = 0.8, 0.2
"""Below this fraction of its length, the direction of a limb's second bone counts less and less."""


@dataclass(frozen=True, eq=False)
class Bones:
    """A body's bones: each joint's offset in its parent's frame, along Y if the parent has one child.

    `moving` joints have no bone, and stay where they are. `bends` holds the usual offset of a limb's middle joint
    (elbow, knee) from the midpoint of the limb's ends, in the frame of the joint with several children above.
    """

    skeleton: Skeleton
    offsets: Float64[np.ndarray, "joints 3"]
    moving: frozenset[int]
    bends: dict[int, Float64[np.ndarray, "3"]]

    @classmethod
    def of(cls, positions: Float[np.ndarray, "frames joints 3"], skeleton: Skeleton) -> "Bones":
        """The bones of some frames: median lengths, and least-squares angles between the bones of one joint."""
        values = positions.astype(np.float64)
        bones = values - values[:, skeleton.parents_or_self]
        middle, spread = _middle_and_spread(bones)
        moving = _moving(skeleton, middle, spread)
        offsets = np.zeros((skeleton.num_joints, 3))
        offsets[:, 1] = middle
        result = cls(skeleton, offsets, moving, {})
        for joint in range(skeleton.num_joints):
            children = result.children(joint)
            if len(children) > 1:
                offsets[children] = _shape(bones[:, children], middle[children])
        targets = values.transpose(1, 0, 2)
        for start, joint, end in result.limbs():
            if (branch := result.branch(joint)) is not None:
                children = result.children(branch)
                turn = _turns(offsets[children], targets[children] - targets[branch])
                bend = targets[joint] - (targets[start] + targets[end]) / 2.0
                result.bends[joint] = np.median(quaternion_rotate(quaternion_conjugate(turn), bend), axis=0)
        return result

    def children(self, joint: int) -> list[int]:
        """A joint's children with a bone."""
        return [child for child in self.skeleton.children(joint) if child not in self.moving]

    def branch(self, joint: int) -> int | None:
        """The nearest ancestor with several bones; None if there is none."""
        above = (each for each in self.skeleton.path_to_root(joint) if each != joint)
        return next((each for each in above if len(self.children(each)) > 1), None)

    def limbs(self) -> list[tuple[int, int, int]]:
        """Start, middle and end of every pair of consecutive bones of similar length."""
        result = []
        for joint in range(self.skeleton.num_joints):
            below, start = self.children(joint), self.skeleton.parents[joint]
            if start < 0 or joint in self.moving or len(below) != 1 or len(self.children(start)) != 1:
                continue
            upper, lower = self.offsets[joint, 1], self.offsets[below[0], 1]
            if min(upper, lower) > LIMB_RATIO * max(upper, lower):
                result.append((start, joint, below[0]))
        return result

    @classmethod
    def lacking(
        cls, positions: Float[np.ndarray, "frames joints 3"], skeleton: Skeleton, *, captured: bool
    ) -> "Bones | None":
        """The bones to project positions onto; None if lengths are constant enough already.

        Captures are left alone if lengths vary by up to some 5 %; generated motion is always made exact. Raises
        `ValueError` for positions that are not finite.
        """
        if not np.isfinite(positions).all():
            raise ValueError("feet cannot be planted: some joint positions are NaN or infinite")
        middle, spread = _middle_and_spread(positions - positions[:, skeleton.parents_or_self])
        allowed = CAPTURED_SHARE * middle + CAPTURED_METRES if captured else ROUNDING_METRES
        changes = set(np.flatnonzero(spread > allowed).tolist()) - {0} - _moving(skeleton, middle, spread)
        return cls.of(positions, skeleton) if changes else None

    def applied(
        self, positions: Float32[np.ndarray, "frames joints 3"], joints: Iterable[int] | None = None
    ) -> Float32[np.ndarray, "frames joints 3"]:
        """The poses with these bones, each joint as close to its position as its bone allows, from the root on.

        Given some `joints`, others than these and those above them may stay where they are.
        """
        needed = set(range(self.skeleton.num_joints))
        if joints is not None:
            needed = {above for joint in joints for above in self.skeleton.path_to_root(joint)}
        targets = np.ascontiguousarray(positions.transpose(1, 0, 2), dtype=np.float64)
        reached, turns, limbs = targets.copy(), {}, {start: (joint, end) for start, joint, end in self.limbs()}
        for joint in range(self.skeleton.num_joints):
            children = self.children(joint)
            if needed.isdisjoint(children):
                continue
            if len(children) > 1:
                shape, aims = self.offsets[children], targets[children] - reached[joint]
                turns[joint] = _turns(shape, aims)
                reached[children] = reached[joint] + quaternion_rotate(turns[joint][:, None], shape).transpose(1, 0, 2)
            else:
                bone, own = targets[children[0]] - reached[joint], self.offsets[children[0], 1]
                reached[children[0]] = reached[joint] + bone * (own / np.maximum(_lengths(bone), NO_LENGTH))[:, None]
                if joint in limbs and children[0] in self.bends:
                    self._bend(targets, reached, turns, (joint, *limbs[joint]))
        return reached.transpose(1, 0, 2).astype(np.float32)

    def _bend(
        self,
        targets: Float64[np.ndarray, "joints frames 3"],
        reached: Float64[np.ndarray, "joints frames 3"],
        turns: dict[int, Float64[np.ndarray, "frames 4"]],
        limb: tuple[int, int, int],
    ) -> None:
        """Moves a limb's middle joint if its second bone has shrunk, so that the end can stay where it is.

        The direction of a bone of nearly no length flips, and the hand with it; moving the elbow avoids that.
        """
        start, joint, end = limb
        upper, lower = self.offsets[joint, 1], self.offsets[end, 1]
        share = _lengths(targets[end] - reached[joint]) / lower
        gone = np.clip((SHRUNK_SHARE - share) / (SHRUNK_SHARE - GONE_SHARE), 0.0, 1.0)
        rows = np.flatnonzero(gone)
        if not len(rows):
            return
        gone = np.square(gone[rows]) * (3.0 - 2.0 * gone[rows])
        branch = self.branch(joint)
        assert branch is not None
        along, reach = _directions(targets[end, rows] - reached[start, rows])
        reach = np.clip(reach, abs(upper - lower) + LEAST_ROOM_METRES, LONGEST_SHARE * (upper + lower))
        usual, _ = _directions(_across(quaternion_rotate(turns[branch][rows], self.bends[joint]), along))
        side = _across(targets[joint, rows] - targets[start, rows], along)
        side, _ = _directions(side + gone[:, None] * (upper * usual - side))
        forth = np.clip((upper**2 - lower**2 + np.square(reach)) / (2.0 * reach), -upper, upper)
        bent = along * forth + side * np.sqrt(upper**2 - np.square(forth))
        old = reached[joint, rows] - reached[start, rows]
        reached[joint, rows] = reached[start, rows] + upper * _directions(old + gone[:, None] * (bent - old))[0]


def _middle_and_spread(
    bones: Float[np.ndarray, "frames joints 3"],
) -> tuple[Float64[np.ndarray, "joints"], Float64[np.ndarray, "joints"]]:
    """The median length of each bone, and the distance of its 5 % and 95 % quantiles."""
    low, middle, high = np.quantile(_lengths(bones), (0.05, 0.5, 0.95), axis=0)
    return middle, high - low


def _moving(
    skeleton: Skeleton, middle: Float64[np.ndarray, "joints"], spread: Float64[np.ndarray, "joints"]
) -> frozenset[int]:
    """The joints without a bone: those that travel, or coincide with their parent."""
    limits = [TRAVELLING_FROM_ROOT_METRES if parent == 0 else TRAVELLING_METRES for parent in skeleton.parents_or_self]
    return frozenset(np.flatnonzero((spread > limits) | (middle < NO_LENGTH)).tolist()) - {0}


def _shape(
    bones: Float64[np.ndarray, "frames bones 3"], lengths: Float64[np.ndarray, "bones"]
) -> Float64[np.ndarray, "bones 3"]:
    """The mean of several bones of one joint after rotational alignment, with the given lengths."""
    shape = bones[len(bones) // 2]
    for _ in range(3):
        turns = fit_rotation(np.broadcast_to(shape, bones.shape), bones)
        shape = np.median(quaternion_rotate(quaternion_conjugate(turns)[:, None], bones), axis=0)
        shape = shape * (lengths / np.maximum(np.linalg.norm(shape, axis=-1), NO_LENGTH))[:, None]
    return np.asarray(shape)


def _turns(
    shape: Float64[np.ndarray, "bones 3"], targets: Float64[np.ndarray, "bones frames 3"]
) -> Float64[np.ndarray, "frames 4"]:
    """The rotations that align a shape with bones by least squares."""
    bones = targets.transpose(1, 0, 2)
    return fit_rotation(np.broadcast_to(shape, bones.shape), bones)


def _across(vectors: Float64[np.ndarray, "frames 3"], along: Float64[np.ndarray, "frames 3"]) -> Vectors:
    return np.asarray(vectors - along * np.einsum("ni,ni->n", vectors, along)[:, None])


def _directions(vectors: Float64[np.ndarray, "frames 3"]) -> tuple[Vectors, Float64[np.ndarray, "frames 1"]]:
    """Unit vectors, and the lengths."""
    lengths = np.maximum(_lengths(vectors), NO_LENGTH)[:, None]
    return vectors / lengths, lengths


def _lengths(vectors: Float[np.ndarray, "*shape 3"]) -> Float64[np.ndarray, "*shape"]:
    return np.asarray(np.linalg.norm(vectors.astype(np.float64), axis=-1))
