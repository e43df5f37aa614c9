"""Writing BVH files: a motion with its skeleton, or a document's own text with new frames."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float64, Int64
from motionkit.core.skeleton import Skeleton
from motionkit.fields.motion_field import Poses
from motionkit.io import number_table
from motionkit.io.body_frame import from_y_up, turn_of
from motionkit.io.bvh import BvhDocument, local_rotations
from motionkit.io.joint_rotations import joint_channels

WRITTEN_DECIMALS = 6
# Tolerance of positions against the expected ones, and of rotations, which are float32.
_SAME_METRES = 2e-6
_SAME_RADIANS = 2e-6
# Gimbal lock: nearer to the pole than this cosine, only the sum of the first and the last angle is determined.
_POLE_COSINE = 1e-5


def write_bvh(motion: Motion, path: Path, *, unit_metres: float = 0.01) -> None:
    """Write a motion with its skeleton: in centimetres unless `unit_metres` is given, ZXY rotations, six decimals.

    Reading it back gives the same framerate, the joints (depth first), and positions within 0.15 mm. A motion without
    rotations gets them by inverse kinematics on its own bones. If rigid bones miss no joint by more than 2 mm, only the
    root has position channels (and joints are within that distance); else every joint has them. The frame time is
    written with all its digits.
    """
    animated = joint_channels(motion)
    skeleton, translations = animated.skeleton, animated.translations
    rotations = animated.rotations.astype(np.float64)
    # In gimbal lock angles are ratios of small numbers, which float32's deviations from unit length would decide.
    rotations /= np.linalg.norm(rotations, axis=-1, keepdims=True)
    angles = np.degrees(_zxy_angles(kinematics.quaternion_to_matrix(rotations)))
    scale = 1.0 / unit_metres
    order = _depth_first(skeleton)
    columns = []
    for joint in order:
        if joint in translations:
            columns.append(translations[joint].astype(np.float64) * scale)
        columns.append(angles[:, joint])
    table = np.round(np.concatenate(columns, axis=1), WRITTEN_DECIMALS) + 0.0
    lines = _hierarchy_lines(skeleton, order, frozenset(translations), scale)
    lines += ["MOTION", f"Frames: {motion.num_frames}", f"Frame Time: {float(1 / motion.fps)!r}", ""]
    path.write_bytes("\n".join(lines).encode() + number_table.format_table(table))


def _zxy_angles(matrices: Float64[np.ndarray, "frames joints 3 3"]) -> Float64[np.ndarray, "frames joints 3"]:
    # R = Rz·Rx·Ry; in gimbal lock, where only z ± y is determined, y is set to zero.
    across = np.hypot(matrices[..., 0, 1], matrices[..., 1, 1])
    pole = across < 1e-9
    x = np.arctan2(matrices[..., 2, 1], across)
    z = np.where(
        pole,
        np.arctan2(matrices[..., 1, 0], matrices[..., 0, 0]),
        np.arctan2(-matrices[..., 0, 1], matrices[..., 1, 1]),
    )
    y = np.where(pole, 0.0, np.arctan2(-matrices[..., 2, 0], matrices[..., 2, 2]))
    return np.stack((z, x, y), axis=-1)


def _depth_first(skeleton: Skeleton) -> list[int]:
    order, stack = [], [0]
    while stack:
        joint = stack.pop()
        order.append(joint)
        stack += reversed(skeleton.children(joint))
    return order


def _hierarchy_lines(skeleton: Skeleton, order: list[int], translated: frozenset[int], scale: float) -> list[str]:
    lines = ["HIERARCHY"]
    tips = dict(skeleton.end_sites)

    def offset(vector: Iterable[float]) -> str:
        return "OFFSET " + " ".join(f"{value * scale:.6f}" for value in vector)

    def close(joint: int, depth: int) -> None:
        tip = tips.get(joint, None if skeleton.children(joint) else (0.0, 0.0, 0.0))
        if tip is not None:
            inner = "\t" * (depth + 1)
            lines.extend((f"{inner}End Site", f"{inner}{{", f"{inner}\t{offset(tip)}", f"{inner}}}"))
        lines.append("\t" * depth + "}")

    open_joints: list[int] = []
    for joint in order:
        while open_joints and open_joints[-1] != skeleton.parents[joint]:
            close(open_joints.pop(), len(open_joints))
        indent = "\t" * len(open_joints)
        places = "Xposition Yposition Zposition " if joint in translated else ""
        lines += [
            f"{indent}{'JOINT' if open_joints else 'ROOT'} {skeleton.joint_names[joint]}",
            f"{indent}{{",
            f"{indent}\t{offset(skeleton.offsets[joint].tolist())}",
            f"{indent}\tCHANNELS {6 if places else 3} {places}Zrotation Xrotation Yrotation",
        ]
        open_joints.append(joint)
    while open_joints:
        close(open_joints.pop(), len(open_joints))
    return lines


def check_writable(document: BvhDocument) -> None:
    """Raise `FormatError` (`channels`) for a joint whose angles do not follow from its rotation."""
    for joint in document.head.hierarchy.joints:
        if any(first == second for first, second in pairwise(joint.order)):
            message = (
                f"joint {joint.name!r} turns twice in a row about one axis ({joint.order}): its angles are not unique"
            )
            raise FormatError(message, path=document.path, reason="channels")


@dataclass(frozen=True, eq=False)
class KnownFrames:
    """The frames of a document, ascending, that are known among new ones, and their times in the written file.

    Row `kept_rows[i]` of the written file is the document's frame `kept_frames[i]`; all ascend.
    """

    frames: Int64[np.ndarray, "known"]
    seconds: Float64[np.ndarray, "known"]
    kept_rows: Int64[np.ndarray, "kept"]
    kept_frames: Int64[np.ndarray, "kept"]


def rewrite_bvh(document: BvhDocument, path: Path, motion: Motion, known: KnownFrames) -> None:
    """Write a motion of the document's skeleton, with rotations, with the document's own text and channels.

    Kept rows are the document's lines, unchanged. The angles of the others continue those of the known frames, and a
    channel that is constant between two known frames keeps its exact digits. Raises `FormatError` as `check_writable`.
    """
    check_writable(document)
    rows = _channel_rows(document, Poses.of(motion), motion.timegrid.seconds(), known)
    lines = number_table.format_table(np.round(rows, WRITTEN_DECIMALS) + 0.0).splitlines()
    for row, frame in zip(known.kept_rows.tolist(), known.kept_frames.tolist(), strict=True):
        lines[row] = document.lines[frame]
    path.write_bytes(document.heading(len(lines), motion.fps) + b"\n".join((*lines, b"")))


def _channel_rows(
    document: BvhDocument, poses: Poses, seconds: Float64[np.ndarray, "times"], known: KnownFrames
) -> Float64[np.ndarray, "times channels"]:
    anchors = document.table[known.frames]
    after = np.searchsorted(known.seconds, seconds + 1e-9, side="right") - 1
    expected = _interpolated(anchors, known.seconds, seconds)
    rows = np.empty_like(expected)
    # Rows before the first known frame continue it backwards in time.
    for places in (np.flatnonzero(after < 0)[::-1], np.flatnonzero(after >= 0)):
        if places.size:
            after_anchor = np.maximum(after[places], 0)
            rows[places] = _converted(document, poses.rows(places), expected[places], anchors, after_anchor)
    return rows


def _interpolated(
    anchors: Float64[np.ndarray, "known channels"],
    known_seconds: Float64[np.ndarray, "known"],
    seconds: Float64[np.ndarray, "times"],
) -> Float64[np.ndarray, "times channels"]:
    """Channels interpolated linearly between known frames, and constant beyond them."""
    left = np.clip(np.searchsorted(known_seconds, seconds, side="right") - 1, 0, max(0, len(anchors) - 2))
    right = np.minimum(left + 1, len(anchors) - 1)
    span = np.where(right > left, known_seconds[right] - known_seconds[left], 1.0)
    fraction = np.clip((seconds - known_seconds[left]) / span, 0.0, 1.0)[:, None]
    return np.asarray(anchors[left] + fraction * (anchors[right] - anchors[left]))


def _converted(
    document: BvhDocument,
    poses: Poses,
    expected: Float64[np.ndarray, "times channels"],
    anchors: Float64[np.ndarray, "known channels"],
    after: Int64[np.ndarray, "times"],
) -> Float64[np.ndarray, "times channels"]:
    """Poses as rows of channels; row t continues the rows after anchor `after[t]`."""
    hierarchy, skeleton = document.head.hierarchy, document.motion.skeleton
    rotations, positions = _file_axes(document, poses)
    placed = (0, *document.moving)
    places = _places(rotations, positions, skeleton, placed)
    # If the file's root only carries the next joint, that one is the body's root.
    carried = len(hierarchy.joints) - skeleton.num_joints
    if carried:
        back = kinematics.quaternion_conjugate(local_rotations(expected, hierarchy)[:, 0].astype(np.float64))
        rotations[:, 0] = kinematics.quaternion_multiply(back, rotations[:, 0])
        root = hierarchy.joints[0]
        carrier = np.repeat(np.array([root.offset], np.float64), len(expected), axis=0)
        carrier[:, list(root.position_columns)] = expected[:, list(root.position_columns.values())]
        places[:, 0] = kinematics.quaternion_rotate(back, places[:, 0] - carrier * document.unit_metres)
    rows = expected.copy()
    for place, body_joint in enumerate(placed):
        for axis, column in hierarchy.joints[body_joint + carried].position_columns.items():
            value = places[:, place, axis] / document.unit_metres
            close = np.abs(value - expected[:, column]) * document.unit_metres < _SAME_METRES
            rows[:, column] = np.where(close, expected[:, column], value)
    for index, joint in enumerate(hierarchy.joints):
        if joint.order and index >= carried:
            columns = joint.rotation_columns
            rows[:, columns] = anchored_angles(
                rotations[:, index - carried], joint.order, expected[:, columns], anchors[:, columns], after
            )
    return rows


def _file_axes(
    document: BvhDocument, poses: Poses
) -> tuple[Float64[np.ndarray, "times joints 4"], Float64[np.ndarray, "times joints 3"]]:
    """Rotations and positions along the file's axes again."""
    assert poses.local_rotations is not None
    rotations, positions = poses.local_rotations.astype(np.float64), poses.joint_positions.astype(np.float64)
    if document.up == "y":
        return rotations, positions
    if document.rest_has_same_up:
        rotations[..., 1:] = from_y_up(rotations[..., 1:], document.up)
    else:
        back = kinematics.quaternion_conjugate(turn_of(document.up).astype(np.float64))
        rotations[:, 0] = kinematics.quaternion_multiply(back, rotations[:, 0])
    return rotations, from_y_up(positions, document.up)


def _places(
    rotations: Float64[np.ndarray, "times joints 4"],
    positions: Float64[np.ndarray, "times joints 3"],
    skeleton: Skeleton,
    joints: tuple[int, ...],
) -> Float64[np.ndarray, "times placed 3"]:
    """Positions of joints in their parent's frame; the root's in the world."""
    places = positions[:, list(joints)]
    if len(joints) > 1:
        world = kinematics.global_rotations(rotations, skeleton)
        for column, joint in enumerate(joints[1:], start=1):
            parent = skeleton.parents[joint]
            back = kinematics.quaternion_conjugate(world[:, parent])
            places[:, column] = kinematics.quaternion_rotate(back, positions[:, joint] - positions[:, parent])
    return places


def anchored_angles(
    rotations: Float64[np.ndarray, "times 4"],
    order: str,
    expected: Float64[np.ndarray, "times axes"],
    anchors: Float64[np.ndarray, "anchors axes"],
    after: Int64[np.ndarray, "times"],
) -> Float64[np.ndarray, "times axes"]:
    """Euler angles in degrees about the axes of `order` (one to three) of each rotation of one joint.

    Row t is continuous with row t − 1 if both come after the same anchor, else with the anchor `after[t]` (degrees). If
    the `expected` angles give the rotation, they are returned, so a constant channel keeps its exact digits. An order
    of fewer than three axes gives the angles of the nearest rotation about those axes.
    """
    axes = order + "".join(axis for axis in "XYZ" if axis not in order) if len(order) < 3 else order
    pad = ((0, 0), (0, 3 - len(order)))
    expected, anchors = np.radians(np.pad(expected, pad)), np.radians(np.pad(anchors, pad))
    principal = _principal_angles(rotations, axes, expected)
    angles = _continued(principal, anchors, after, is_proper=axes[0] == axes[2])
    between = kinematics.quaternion_multiply(
        kinematics.quaternion_conjugate(kinematics.euler_to_quaternion(expected, axes)), rotations
    )
    same = 2 * np.arctan2(np.linalg.norm(between[:, 1:], axis=-1), np.abs(between[:, 0])) < _SAME_RADIANS
    return np.degrees(np.where(same[:, None], expected, angles))[:, : len(order)]


def _principal_angles(
    rotations: Float64[np.ndarray, "times 4"], axes: str, expected: Float64[np.ndarray, "times 3"]
) -> Float64[np.ndarray, "times 3"]:
    """One triple per rotation; in gimbal lock the one with the expected last angle."""
    import warnings

    from scipy.spatial.transform import Rotation

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about gimbal lock, handled below
        angles = np.array(Rotation.from_quat(rotations, scalar_first=True).as_euler(axes))  # type: ignore[call-overload]
    second = angles[:, 1]
    pole = np.abs(np.sin(second) if axes[0] == axes[2] else np.cos(second)) < _POLE_COSINE
    if pole.any():
        last_two = np.stack((second[pole], expected[pole, 2]), axis=-1)
        rest = kinematics.quaternion_conjugate(kinematics.euler_to_quaternion(last_two, axes[1:]))
        first = kinematics.quaternion_multiply(rotations[pole], rest)
        angles[pole, 0] = 2 * np.arctan2(first[:, "XYZ".index(axes[0]) + 1], first[:, 0])
        angles[pole, 2] = expected[pole, 2]
    return angles


def _continued(
    principal: Float64[np.ndarray, "times 3"],
    anchors: Float64[np.ndarray, "anchors 3"],
    after: Int64[np.ndarray, "times"],
    *,
    is_proper: bool,
) -> Float64[np.ndarray, "times 3"]:
    """The triples and full turns that continue the anchors.

    A rotation has two triples. The shorter step from one row to the next is between the same of both, or between
    different ones; which of them a row has is thus the parity of the changes since its anchor.
    """
    first, second, third = principal.T
    other = np.stack((first + np.pi, -second if is_proper else np.pi - second, third + np.pi), axis=-1)
    is_first = np.concatenate(([True], after[1:] != after[:-1]))  # of the rows after the same anchor
    first_row = np.maximum.accumulate(np.where(is_first, np.arange(len(after)), 0))
    start = anchors[after]

    def steps_to(angles: Float64[np.ndarray, "times 3"], rows: Float64[np.ndarray, "times 3"]) -> np.ndarray:
        previous = np.where(is_first[:, None], start, np.concatenate((start[:1], rows[:-1])))
        return _within_half_turn(angles - previous)

    changes = np.abs(steps_to(other, principal)).sum(axis=-1) < np.abs(steps_to(principal, principal)).sum(axis=-1)
    total = np.cumsum(changes)
    is_other = (total - total[first_row] + changes[first_row]) % 2 == 1
    chosen = np.where(is_other[:, None], other, principal)
    steps = np.cumsum(steps_to(chosen, chosen), axis=0)
    unwound = start + steps - np.where(first_row[:, None] > 0, steps[first_row - 1], 0.0)
    # The sum gives only the number of full turns, so that rounding errors of the angle do not accumulate.
    return np.asarray(chosen + 2 * np.pi * np.rint((unwound - chosen) / (2 * np.pi)))


def _within_half_turn(angles: Float64[np.ndarray, "*shape"]) -> Float64[np.ndarray, "*shape"]:
    return np.asarray(angles - 2 * np.pi * np.rint(angles / (2 * np.pi)))
