"""From a BVH file's channel table to local rotations, a root path and bones, in file units; Euler angles."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from motionkit.core import kinematics
from motionkit.core.kinematics import euler_to_quaternion, quaternion_conjugate, quaternion_multiply
from motionkit.core.shapes import Bool, Float, Float32, Float64, Int64
from motionkit.core.skeleton import Skeleton
from motionkit.io.bvh.text import BvhHierarchy

PART_FRAMES = 4096
# Bones are longer than this, relative to their OFFSET.
NO_BONE = 1e-3
# Memory limit of the median offsets: joints are processed in groups of this many bytes over all frames.
MEDIAN_BYTES = 16 << 20


@dataclass(frozen=True)
class ChannelPose:
    """The decoded channels, lengths in file units.

    `places` are the offsets that position channels give to `placed_joints`, which are below the root.
    """

    skeleton: Skeleton
    rotations: Float32[np.ndarray, "frames joints 4"]
    root: Float64[np.ndarray, "frames 3"]
    placed_joints: tuple[int, ...]
    places: Float64[np.ndarray, "frames placed 3"]
    operations: tuple[str, ...] = ()

    def parts(self) -> Iterator["ChannelPose"]:
        """The same in chunks of some thousand frames."""
        for start in range(0, len(self.root), PART_FRAMES):
            yield self.frames(slice(start, start + PART_FRAMES))

    def frames(self, which: slice | Int64[np.ndarray, "rows"]) -> "ChannelPose":
        """Some of the frames."""
        return replace(self, rotations=self.rotations[which], root=self.root[which], places=self.places[which])

    def places_of(self, joints: tuple[int, ...]) -> Float64[np.ndarray, "frames joints 3"]:
        """The offsets of some of the placed joints."""
        if joints == self.placed_joints:
            return self.places
        return self.places[:, [self.placed_joints.index(joint) for joint in joints]]


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
    # Time is contiguous in memory, as later operations run along it.
    places = places.transpose(2, 0, 1)
    return ChannelPose(skeleton, _rotations(table, hierarchy), places[:, 0], placed, places[:, 1:], operations)


def join(pieces: Iterable[ChannelPose], num_frames: int) -> ChannelPose:
    """Concatenate consecutive poses, `num_frames` frames in total; common fields are those of the first."""
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

    The rule: in frame 0 the root has no rotation and every angle is a whole number of degrees, in frame 1 neither
    holds, and the root's position is the same in both. Captured poses do not satisfy it.
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
    """Remove a root that only carries one moving joint, which becomes the root (Bandai-Namco's `joint_Root`)."""
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
    """The skeleton with its bones in the first frame: position channels override an OFFSET."""
    offsets, joints, places = pose.skeleton.offsets.copy(), list(pose.placed_joints), pose.places[0]
    offsets[joints] = np.where(_says_nothing(places, places, offsets[joints])[:, None], offsets[joints], places)
    return replace(pose.skeleton, offsets=offsets)


def _says_nothing(
    lowest: Float64[np.ndarray, "placed 3"],
    highest: Float64[np.ndarray, "placed 3"],
    offsets: Float[np.ndarray, "placed 3"],
) -> Bool[np.ndarray, "placed"]:
    """Whether position channels are 0 up to rounding but the OFFSET is not (MakeHuman): the OFFSET then applies."""
    farthest = np.maximum(np.abs(lowest), np.abs(highest)).max(axis=1, initial=0.0)
    return np.asarray(farthest < NO_BONE * np.linalg.norm(offsets, axis=1))


def settle_offsets(
    pose: ChannelPose, pieces: Callable[[], Iterator[ChannelPose]], tolerance: float
) -> tuple[Skeleton, tuple[int, ...]]:
    """The bones of all frames, in file units, and the joints that move relative to their parents.

    Position channels that stay within `tolerance` file units are a constant offset. A constant that agrees with the
    file's OFFSET, or is 0 where that is not, leaves the OFFSET unchanged, so that takes share their skeleton. Each call
    of `pieces` iterates over all frames.
    """
    if not pose.placed_joints:
        return pose.skeleton, ()
    joints, offsets = np.array(pose.placed_joints), pose.skeleton.offsets.copy()
    ranges = [(piece.places.min(axis=0), piece.places.max(axis=0), len(piece.root)) for piece in pieces()]
    lowest = np.min([low for low, _, _ in ranges], axis=0)
    highest = np.max([high for _, high, _ in ranges], axis=0)
    far = np.maximum(offsets[joints] - lowest, highest - offsets[joints]).max(axis=1) > tolerance
    astray = np.flatnonzero(far & ~_says_nothing(lowest, highest, offsets[joints]))
    if not astray.size:
        return pose.skeleton, ()
    at_once = max(1, MEDIAN_BYTES // (24 * sum(length for _, _, length in ranges)))
    middle = np.concatenate(
        [
            np.median(np.concatenate([piece.places[:, some] for piece in pieces()]), axis=0, overwrite_input=True)
            for some in np.split(astray, range(at_once, len(astray), at_once))
        ]
    )
    offsets[joints[astray]] = middle
    moving = astray[np.maximum(middle - lowest[astray], highest[astray] - middle).max(axis=1, initial=0.0) > tolerance]
    return replace(pose.skeleton, offsets=offsets), tuple(joints[moving].tolist())


def unique_names(names: list[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names made unique by _2, _3 …, and a log line if any was changed."""
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


def joints_by_order(hierarchy: BvhHierarchy) -> dict[str, list[int]]:
    """The joints with rotation channels, by the order of their axes."""
    orders: dict[str, list[int]] = {}
    for index, joint in enumerate(hierarchy.joints):
        if joint.order:
            orders.setdefault(joint.order, []).append(index)
    return orders


def _rotations(
    table: Float64[np.ndarray, "frames channels"], hierarchy: BvhHierarchy
) -> Float32[np.ndarray, "frames joints 4"]:
    # Component-major in memory, as forward kinematics needs it. Joints with the same order of axes are batched.
    components = np.zeros((4, len(hierarchy.joints), len(table)), np.float32)
    components[0] = 1.0
    for order, members in joints_by_order(hierarchy).items():
        columns = [hierarchy.joints[index].rotation_columns[axis] for axis in range(len(order)) for index in members]
        degrees = np.ascontiguousarray(table.take(columns, axis=1).T)
        angles = np.radians(degrees).astype(np.float32).reshape(len(order), len(members), len(table))
        components[:, members] = kinematics.euler_to_quaternion(np.moveaxis(angles, 0, -1), order).transpose(2, 0, 1)
    return components.transpose(2, 1, 0)


# Gimbal lock: nearer to the pole than this cosine, only the sum of the first and the last angle is determined.
_POLE_COSINE = 1e-5
# Rotations closer than this are equal: quaternions are float32.
_SAME_RADIANS = 2e-6


def anchored_angles(
    rotations: Float64[np.ndarray, "times joints 4"],
    order: str,
    expected: Float64[np.ndarray, "times joints axes"],
    anchors: Float64[np.ndarray, "anchors joints axes"],
    after: Int64[np.ndarray, "times"],
) -> Float64[np.ndarray, "times joints axes"]:
    """Euler angles in degrees about the axes of `order` (one to three) of each rotation.

    Row t is continuous with row t − 1 if both come after the same anchor, else with the anchor `after[t]` (degrees). If
    the `expected` angles give the rotation, they are returned, so a constant channel keeps its exact digits. An order
    of fewer than three axes gives the angles of the nearest rotation about those axes.
    """
    axes = order + "".join(axis for axis in "XYZ" if axis not in order) if len(order) < 3 else order
    pad = ((0, 0), (0, 0), (0, 3 - len(order)))
    expected, anchors = np.radians(np.pad(expected, pad)), np.radians(np.pad(anchors, pad))
    found = _principal(rotations, axes, expected)
    angles = _followed(found, anchors, after, is_proper=axes[0] == axes[2])
    same = _angle_between(euler_to_quaternion(expected, axes), rotations) < _SAME_RADIANS
    return np.degrees(np.where(same[..., None], expected, angles))[..., : len(order)]


def _principal(
    rotations: Float64[np.ndarray, "times joints 4"], axes: str, expected: Float64[np.ndarray, "times joints 3"]
) -> Float64[np.ndarray, "times joints 3"]:
    # One triple per rotation; in gimbal lock the one with the expected last angle.
    import warnings

    from scipy.spatial.transform import Rotation

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about gimbal lock, handled below
        found = Rotation.from_quat(rotations.reshape(-1, 4), scalar_first=True).as_euler(axes)  # type: ignore[call-overload]
    angles = np.asarray(found).reshape(expected.shape)
    second = angles[..., 1]
    pole = np.abs(np.sin(second) if axes[0] == axes[2] else np.cos(second)) < _POLE_COSINE
    if pole.any():
        last_two = np.stack((second[pole], expected[pole][:, 2]), axis=-1)
        rest = quaternion_conjugate(euler_to_quaternion(last_two, axes[1:]))
        first = quaternion_multiply(rotations[pole], rest)
        angles[pole, 0] = 2 * np.arctan2(first[:, "XYZ".index(axes[0]) + 1], first[:, 0])
        angles[pole, 2] = expected[pole][:, 2]
    return angles


def _followed(
    found: Float64[np.ndarray, "times joints 3"],
    anchors: Float64[np.ndarray, "anchors joints 3"],
    after: Int64[np.ndarray, "times"],
    *,
    is_proper: bool,
) -> Float64[np.ndarray, "times joints 3"]:
    # Steps between consecutive rows in either triple; they differ only in the sign of the second angle.
    first_of_run = np.concatenate(([True], after[1:] != after[:-1]))
    start = anchors[after]
    before = np.where(first_of_run[:, None, None], start, np.concatenate((start[:1], found[:-1])))
    straight, crossed = _turned(found - before), _turned(_other(found, is_proper) - before)
    crosses = np.abs(crossed).sum(axis=-1) < np.abs(straight).sum(axis=-1)
    # A row's triple is the parity of its run's changes so far: counted over all runs, less those before the run.
    total = np.cumsum(crosses, axis=0)
    run_start = np.maximum.accumulate(np.where(first_of_run, np.arange(len(after)), 0))
    counted = total - total[run_start] + crosses[run_start]
    other: Bool[np.ndarray, "times joints"] = counted % 2 == 1
    chosen = np.where(other[..., None], _other(found, is_proper), found)
    previous = np.where(first_of_run[:, None, None], start, np.concatenate((start[:1], chosen[:-1])))
    steps = np.cumsum(_turned(chosen - previous), axis=0)
    unwound = start + steps - np.where(run_start[:, None, None] > 0, steps[run_start - 1], 0.0)
    # The sum gives only the number of full turns, so that rounding errors of the angle do not accumulate.
    turns = np.rint((unwound - chosen) / (2 * np.pi))
    return np.asarray(chosen + 2 * np.pi * turns)


def _other(angles: Float64[np.ndarray, "times joints 3"], is_proper: bool) -> Float64[np.ndarray, "times joints 3"]:
    a, b, c = np.moveaxis(angles, -1, 0)
    return np.stack((a + np.pi, -b if is_proper else np.pi - b, c + np.pi), axis=-1)


def _turned(angles: Float64[np.ndarray, "*shape"]) -> Float64[np.ndarray, "*shape"]:
    # Into [−π, π].
    return np.asarray(angles - 2 * np.pi * np.rint(angles / (2 * np.pi)))


def _angle_between(
    a: Float64[np.ndarray, "times joints 4"], b: Float64[np.ndarray, "times joints 4"]
) -> Float64[np.ndarray, "times joints"]:
    between = quaternion_multiply(quaternion_conjugate(a), b)
    return np.asarray(2 * np.arctan2(np.linalg.norm(between[..., 1:], axis=-1), np.abs(between[..., 0])))
