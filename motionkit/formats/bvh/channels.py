"""From a BVH file's channel table to local rotations, a root path and bones, still in file units."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from jaxtyping import Float32, Float64

from motionkit import kinematics
from motionkit.formats.bvh.hierarchy import BvhHierarchy
from motionkit.skeleton import Skeleton


@dataclass(frozen=True)
class ChannelPose:
    """What the channels say, lengths in file units.

    `places` are the offsets that position channels give to `placed_joints`, which are below the root.
    """

    skeleton: Skeleton
    rotations: Float32[np.ndarray, "frames joints 4"]
    root: Float64[np.ndarray, "frames 3"]
    placed_joints: tuple[int, ...]
    places: Float64[np.ndarray, "frames placed 3"]
    operations: tuple[str, ...] = ()


def read_channels(table: Float64[np.ndarray, "frames channels"], hierarchy: BvhHierarchy, name: str) -> ChannelPose:
    """Split the table into rotations, the root's path and moving offsets."""
    joints = hierarchy.joints
    names, operations = unique_names([joint.name for joint in joints])
    offsets = np.array([joint.offset for joint in joints], dtype=np.float64)
    skeleton = Skeleton(
        name=name,
        joint_names=names,
        parents=tuple(joint.parent for joint in joints),
        offsets=offsets.astype(np.float32),
        end_sites=tuple(
            (index, joint.end_site) for index, joint in enumerate(joints) if joint.end_site and any(joint.end_site)
        ),
    )
    placed = tuple(index for index, joint in enumerate(joints) if index and joint.position_columns)
    places = np.repeat(offsets[[0, *placed]][:, :, None], len(table), axis=2)
    cells = [
        (place, axis, column)
        for place, index in enumerate((0, *placed))
        for axis, column in joints[index].position_columns.items()
    ]
    if cells:
        rows, axes, columns = (list(part) for part in zip(*cells, strict=True))
        places[rows, axes] = table.take(columns, axis=1).T
    # Time is contiguous in memory, as everything that follows wants it.
    places = places.transpose(2, 0, 1)
    return ChannelPose(skeleton, _rotations(table, hierarchy), places[:, 0], placed, places[:, 1:], operations)


def join(pieces: Iterable[ChannelPose], num_frames: int) -> ChannelPose:
    """Poses of `num_frames` frames in all that follow each other as one; the first says what they have in common."""
    rest = iter(pieces)
    first = next(rest)
    if len(first.root) == num_frames:
        assert next(rest, None) is None
        return first
    arrays = [
        np.empty((num_frames, *array.shape[1:]), array.dtype) for array in (first.rotations, first.root, first.places)
    ]
    start = 0
    for piece in chain([first], rest):
        stop = start + len(piece.root)
        for array, part in zip(arrays, (piece.rotations, piece.root, piece.places), strict=True):
            array[start:stop] = part
        start = stop
    rotations, root, places = arrays
    return replace(first, rotations=rotations, root=root, places=places)


def starts_with_t_pose(table: Float64[np.ndarray, "frames channels"], hierarchy: BvhHierarchy) -> bool:
    """Whether frame 0 is the T-pose that B. Hahne's conversions of the CMU database begin with.

    The rule: in frame 0 the root is unturned and every angle is a whole number of degrees, in frame 1 neither holds,
    and the root is in the same place in both. A captured pose does not fulfil it.
    """
    if len(table) < 2:
        return False
    root = hierarchy.joints[0]
    places = list(root.position_columns.values())
    if not places or len(root.rotation_columns) != 3 or len(hierarchy.joints) < 15:
        return False
    first, second = table[0], table[1]
    if first[root.rotation_columns].any() or not second[root.rotation_columns].any():
        return False
    angles = [column for joint in hierarchy.joints for column in joint.rotation_columns]
    whole = table[:2, angles] == np.round(table[:2, angles])
    return bool(whole[0].all() and not whole[1].all() and np.array_equal(first[places], second[places]))


def fold_reference(pose: ChannelPose) -> ChannelPose:
    """Let a root that only carries one moving joint go: that joint becomes the root (Bandai-Namco's `joint_Root`)."""
    skeleton = pose.skeleton
    if (
        1 not in pose.placed_joints
        or skeleton.children(0) != (1,)
        or any(joint == 0 for joint, _ in skeleton.end_sites)
    ):
        return pose
    turn = pose.rotations[:, 0].astype(np.float64)
    rotations = pose.rotations[:, 1:].copy(order="K")
    rotations[:, 0] = kinematics.quaternion_multiply(pose.rotations[:, 0], pose.rotations[:, 1])
    offsets = skeleton.offsets[1:].copy()
    offsets[0] = 0.0
    folded = replace(
        skeleton,
        joint_names=skeleton.joint_names[1:],
        parents=(-1, *(parent - 1 for parent in skeleton.parents[2:])),
        offsets=offsets,
        end_sites=tuple((joint - 1, tip) for joint, tip in skeleton.end_sites),
    )
    return ChannelPose(
        folded,
        rotations,
        pose.root + kinematics.quaternion_rotate(turn, pose.places[:, 0]),
        tuple(joint - 1 for joint in pose.placed_joints[1:]),
        pose.places[:, 1:],
        (
            *pose.operations,
            f"joint {skeleton.joint_names[0]!r} folded into {skeleton.joint_names[1]!r}, which moves in it",
        ),
    )


def first_skeleton(pose: ChannelPose) -> Skeleton:
    """The skeleton with the bones that it has in the first frame: position channels overrule an OFFSET."""
    offsets = pose.skeleton.offsets.copy()
    offsets[list(pose.placed_joints)] = pose.places[0]
    return replace(pose.skeleton, offsets=offsets)


def settle_offsets(pose: ChannelPose, tolerance: float) -> ChannelPose:
    """Where position channels stay within `tolerance` file units, make them plain offsets; keep the rest moving.

    A constant that agrees with the file's OFFSET leaves the OFFSET as it is, so that takes share their skeleton.
    """
    if not pose.placed_joints:
        return pose
    joints = np.array(pose.placed_joints)
    offsets = pose.skeleton.offsets.copy()
    lowest, highest = pose.places.min(axis=0), pose.places.max(axis=0)
    astray = np.flatnonzero(np.maximum(offsets[joints] - lowest, highest - offsets[joints]).max(axis=1) > tolerance)
    if not astray.size:
        return replace(pose, placed_joints=(), places=pose.places[:, :0])
    # One joint after the other: of a long take copies of all would be as large as all else.
    middle = np.stack([np.median(pose.places[:, joint], axis=0) for joint in astray.tolist()])
    offsets[joints[astray]] = middle
    moving = astray[np.maximum(middle - lowest[astray], highest[astray] - middle).max(axis=1, initial=0.0) > tolerance]
    return replace(
        pose,
        skeleton=replace(pose.skeleton, offsets=offsets),
        placed_joints=tuple(joints[moving].tolist()),
        places=pose.places if len(moving) == len(joints) else pose.places[:, moving],
    )


def unique_names(names: list[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names made unique by _2, _3 …, and a log line where that was needed."""
    taken: set[str] = set()
    unique: list[str] = []
    for name in names:
        candidate, number = name, 2
        while candidate in taken:
            candidate, number = f"{name}_{number}", number + 1
        taken.add(candidate)
        unique.append(candidate)
    changed = [new for old, new in zip(names, unique, strict=True) if old != new]
    return tuple(unique), (f"repeated joint names made unique: {', '.join(changed)}",) if changed else ()


def _rotations(
    table: Float64[np.ndarray, "frames channels"], hierarchy: BvhHierarchy
) -> Float32[np.ndarray, "frames joints 4"]:
    # Component-major in memory, as forward kinematics wants it. Joints with one order of axes are done together.
    components = np.zeros((4, len(hierarchy.joints), len(table)), np.float32)
    components[0] = 1.0
    orders: dict[str, list[int]] = {}
    for index, joint in enumerate(hierarchy.joints):
        if joint.order:
            orders.setdefault(joint.order, []).append(index)
    for order, members in orders.items():
        columns = [hierarchy.joints[index].rotation_columns[axis] for axis in range(len(order)) for index in members]
        degrees = np.ascontiguousarray(table.take(columns, axis=1).T)
        angles = np.radians(degrees).astype(np.float32).reshape(len(order), len(members), len(table))
        components[:, members] = kinematics.euler_to_quaternion(np.moveaxis(angles, 0, -1), order).transpose(2, 0, 1)
    return components.transpose(2, 1, 0)
