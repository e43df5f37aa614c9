"""One rig: its tree, its bones, and the mapping of its joints to the 22 joints."""

from dataclasses import dataclass

from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.skeletons.mapping import SkeletonMapError, joint_map


@dataclass(frozen=True)
class RigJoint:
    """A joint: how many are above it, its offset from the one above in metres, the layout's joints it is part of."""

    name: str
    parent: str
    depth: int
    offset: tuple[float, float, float]
    taken_for: tuple[str, ...]


@dataclass(frozen=True)
class RigTree:
    """A rig's joints; `family` is the map that fits it, empty where none does and joints are `missing`."""

    family: str
    missing: tuple[str, ...]
    joints: tuple[RigJoint, ...]


def rig_of(skeleton: Skeleton) -> RigTree:
    """The mapping of a skeleton to the 22 joints."""
    family = ""
    missing: tuple[str, ...] = ()
    used: dict[str, list[str]] = {name: [] for name in skeleton.joint_names}
    try:
        found = joint_map(skeleton, SMPL22.name)
        family = found.family
        for row, joint in zip(found.weights, SMPL22.joint_names, strict=True):
            for column in row.nonzero()[0].tolist():
                used[skeleton.joint_names[column]].append(joint)
    except SkeletonMapError as error:
        missing = error.missing
    depths: list[int] = []
    joints = []
    for joint_name, parent, offset in zip(
        skeleton.joint_names, skeleton.parents, skeleton.offsets.tolist(), strict=True
    ):
        depths.append(depths[parent] + 1 if parent >= 0 else 0)
        above = skeleton.joint_names[parent] if parent >= 0 else ""
        joints.append(RigJoint(joint_name, above, depths[-1], tuple(offset), tuple(used[joint_name])))
    return RigTree(family, missing, tuple(joints))
