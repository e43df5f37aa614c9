"""What skeletons a store holds and which of their joints reach the standard layouts."""

from collections import Counter
from dataclasses import dataclass

from motionkit.skeleton import SMPL22, Skeleton
from motionkit.skeletons.mapping import SkeletonMapError, joint_map
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
