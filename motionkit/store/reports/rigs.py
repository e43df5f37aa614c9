"""What skeletons a store holds, which of their joints reach the standard layouts, and how large the bodies are."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.skeletons.mapping import SkeletonMapError, joint_map
from motionkit.store.reader import Store


@dataclass(frozen=True)
class Rig:
    """Skeletons with the same joints and the same map, and how they reach the 22-joint layout.

    `names` are theirs, `num_skeletons` counts different bone lengths. `family` is the table that maps them (empty where
    none does: then `missing` names the layout's joints without a source), `own_map` says whether it is the user's;
    `unmapped` are joints that the layout does not use, `made_up` toes without any source.
    """

    names: tuple[str, ...]
    num_joints: int
    num_skeletons: int
    num_sequences: int
    family: str
    own_map: bool
    missing: tuple[str, ...]
    unmapped: tuple[str, ...]
    made_up: tuple[str, ...]


def rigs(store: Store) -> tuple[Rig, ...]:
    """The rigs of a store, the one with most sequences first; reads the two small tables only."""
    counts: Counter[str] = Counter(store.sequences_table["skeleton"].to_pylist())
    groups: dict[tuple[object, ...], list[Skeleton]] = {}
    for skeleton in store.skeletons.values():
        tips = tuple(joint for joint, _ in skeleton.end_sites)
        groups.setdefault((skeleton.joint_names, tips, skeleton.layout_map), []).append(skeleton)
    found = [_rig(members, sum(counts[member.fingerprint] for member in members)) for members in groups.values()]
    return tuple(sorted(found, key=lambda rig: (-rig.num_sequences, rig.names)))


def _rig(members: list[Skeleton], num_sequences: int) -> Rig:
    first = members[0]
    missing: tuple[str, ...]
    made_up: tuple[str, ...]
    try:
        mapping = joint_map(first, SMPL22.name)
        name, missing, unmapped, made_up = mapping.family, (), mapping.unmapped, mapping.made_up
    except SkeletonMapError as error:
        name, missing, unmapped, made_up = "", error.missing, first.joint_names, ()
    return Rig(
        names=tuple(sorted({member.name for member in members})),
        num_joints=first.num_joints,
        num_skeletons=len(members),
        num_sequences=num_sequences,
        family=name,
        own_map=bool(first.layout_map),
        missing=missing,
        unmapped=unmapped,
        made_up=made_up,
    )


# Grown people differ by a third, a child from a grown man by less than 2; an inch is 2.54 cm, CMU's unit 2.2 inches.
UNLIKE_FACTOR = 2.0


class BodySizes:
    """Remembers how long the bones are, in sum, of the first skeleton of each set of joints."""

    def __init__(self, known: Iterable[Skeleton]) -> None:
        self._first: dict[tuple[str, ...], tuple[float, str]] = {}
        for skeleton in known:
            self.doubt(skeleton)

    def doubt(self, skeleton: Skeleton) -> str:
        """What to tell of a skeleton of another size than the first with its joints; empty where there is nothing."""
        size = float(np.linalg.norm(skeleton.offsets[1:], axis=-1).sum())
        if size == 0.0:  # markers
            return ""
        first, name = self._first.setdefault(skeleton.joint_names, (size, skeleton.name))
        factor = max(size / first, first / size)
        if factor < UNLIKE_FACTOR:
            return ""
        return (
            f"its body is {factor:.3g} times {'as large' if size > first else 'smaller'} as that of skeleton {name!r}, "
            "which has the same joints: was the unit of one of them taken for another? The log says which it was; "
            "--unit-metres sets it"
        )
