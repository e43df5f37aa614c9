"""Identifies skeletons that differ by rounding of their lengths only."""

from collections.abc import Iterable

import numpy as np

from motionkit.core.skeleton import Skeleton

# LaFAN1's takes state one body's lengths as 43.500000 and 43.499996 cm.
SAME_METRES = 1e-6


class SameSkeletons:
    """Maps skeletons that differ by rounding of lengths only to the first of them."""

    def __init__(self, known: Iterable[Skeleton] = ()) -> None:
        self._found: dict[str, Skeleton] = {}
        self._by_joints: dict[tuple[object, ...], list[Skeleton]] = {}
        for skeleton in known:
            self._remember(skeleton, skeleton)

    def first_of(self, skeleton: Skeleton) -> Skeleton:
        """The first skeleton that equals this one with lengths within 1 µm; else itself."""
        found = self._found.get(skeleton.fingerprint)
        if found is None:
            others = self._by_joints.get(_joints_of(skeleton), ())
            found = next((each for each in others if _same_lengths(each, skeleton)), skeleton)
            self._remember(skeleton, found)
        return found

    def _remember(self, skeleton: Skeleton, found: Skeleton) -> None:
        self._found[skeleton.fingerprint] = found
        if found is skeleton:
            self._by_joints.setdefault(_joints_of(skeleton), []).append(skeleton)


def _joints_of(skeleton: Skeleton) -> tuple[object, ...]:
    ends = tuple(joint for joint, _ in skeleton.end_sites)
    return (skeleton.joint_names, skeleton.parents, skeleton.left_right_pairs, skeleton.feet, ends, skeleton.layout_map)


def _same_lengths(one: Skeleton, other: Skeleton) -> bool:
    pairs = [(one.offsets, other.offsets)]
    pairs += [(np.array(a), np.array(b)) for (_, a), (_, b) in zip(one.end_sites, other.end_sites, strict=True)]
    return all(np.allclose(a, b, rtol=0.0, atol=SAME_METRES) for a, b in pairs)
