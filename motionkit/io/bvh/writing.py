"""Writing BVH files: a motion with its skeleton, or a document's own text with new frames."""

from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float64, Int64
from motionkit.core.skeleton import Skeleton
from motionkit.fields.motion_field import Poses
from motionkit.io.bvh import channels
from motionkit.io.bvh.document import BvhDocument, read_bvh, read_document
from motionkit.io.registry import Format, of_path
from motionkit.io.source import number_table
from motionkit.io.source.joint_channels import joint_channels

WRITTEN_DECIMALS = 6


def write_bvh(motion: Motion, path: Path, *, unit_metres: float = 0.01) -> None:
    """Write a motion with its skeleton: in centimetres unless `unit_metres` is given, ZXY rotations, six decimals.

    Reading it back gives the same framerate, the joints (depth first), and positions within 0.15 mm. A motion without
    rotations gets them by inverse kinematics on its own bones. If rigid bones miss no joint by more than 2 mm, only the
    root has position channels (and joints are within that distance); else every joint has them. The frame time is
    written with all its digits.
    """
    made = joint_channels(motion)
    skeleton, translations = made.skeleton, made.translations
    rotations = made.rotations.astype(np.float64)
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
            raise FormatError(message, path=document.lines.file.path, reason="channels")


# Tolerance of positions against the expected ones, which are float32.
_SAME_METRES = 2e-6


class ChannelLines:
    """Converts poses to lines of a document, in order of time; owns the last row, which the next one continues.

    `anchors` are the document's known frames, ascending, and `seconds` their times.
    """

    def __init__(
        self, document: BvhDocument, anchors: Int64[np.ndarray, "anchors"], seconds: Float64[np.ndarray, "anchors"]
    ) -> None:
        self._document = document
        self._frames = anchors
        self._known_seconds = seconds
        self._last_row: Float64[np.ndarray, "1 channels"] | None = None
        self._last_after = -1

    def lines(
        self,
        seconds: Float64[np.ndarray, "times"],
        poses: Poses,
        given_rows: Int64[np.ndarray, "given"],
        given_frames: Int64[np.ndarray, "given"],
    ) -> list[bytes]:
        """The lines of consecutive frames; `given_rows` of them are the document's `given_frames`, copied verbatim.

        All frames before the first known one must be in the first call.
        """
        rows = self._rows(seconds, poses)
        rows[given_rows] = self._document.lines.table(given_frames)
        self._last_row = rows[-1:].copy()
        made = number_table.format_table(np.round(rows, WRITTEN_DECIMALS) + 0.0).splitlines()
        for row, frame in zip(given_rows.tolist(), given_frames.tolist(), strict=True):
            made[row] = self._document.lines.line(frame)
        return made

    def _rows(self, seconds: Float64[np.ndarray, "times"], poses: Poses) -> Float64[np.ndarray, "times channels"]:
        known = self._known_seconds
        after = np.searchsorted(known, seconds + 1e-9, side="right") - 1
        leading = after < 0
        expected = self._expected(seconds)
        if leading.any():
            back = np.flatnonzero(leading)[::-1]
            rows = np.empty_like(expected)
            first_known = self._document.lines.table(self._frames[:1])
            rows[back] = self._converted(poses.rows(back), expected[back], first_known, np.zeros_like(after[back]))
            rest = np.flatnonzero(~leading)
            if rest.size:
                rows[rest] = self._converted(poses.rows(rest), expected[rest], *self._anchors(after[rest]))
            return rows
        return self._converted(poses, expected, *self._anchors(after))

    def _anchors(
        self, after: Int64[np.ndarray, "times"]
    ) -> tuple[Float64[np.ndarray, "anchors channels"], Int64[np.ndarray, "times"]]:
        # The relevant known rows; a stretch that began in the previous call continues from its last row.
        first, goes_on = int(after[0]), self._last_row is not None and self._last_after == after[0]
        known = self._document.lines.table(self._frames[first : int(after[-1]) + 1])
        if goes_on and self._last_row is not None:
            known[0] = self._last_row[0]
        self._last_after = int(after[-1])
        return known, after - first

    def _expected(self, seconds: Float64[np.ndarray, "times"]) -> Float64[np.ndarray, "times channels"]:
        # Channels interpolated linearly between known frames, and constant beyond them.
        known = self._known_seconds
        left = np.clip(np.searchsorted(known, seconds, side="right") - 1, 0, max(0, len(known) - 2))
        right = np.minimum(left + 1, len(known) - 1)
        span = np.where(right > left, known[right] - known[left], 1.0)
        fraction = np.clip((seconds - known[left]) / span, 0.0, 1.0)[:, None]
        before, behind = (self._document.lines.table(self._frames[places]) for places in (left, right))
        return np.asarray(before + fraction * (behind - before))

    def _converted(
        self,
        poses: Poses,
        expected: Float64[np.ndarray, "times channels"],
        anchors: Float64[np.ndarray, "anchors channels"],
        after: Int64[np.ndarray, "times"],
    ) -> Float64[np.ndarray, "times channels"]:
        document, hierarchy = self._document, self._document.head.hierarchy
        assert poses.local_rotations is not None
        rotations, positions = document.body.file_axes(
            poses.local_rotations.astype(np.float64), poses.joint_positions.astype(np.float64)
        )
        placed = (0, *document.body.moving)
        places = _places(rotations, positions, document.skeleton, placed)
        # If the file's root only carries the next joint, that one is the body's root.
        carried = len(hierarchy.joints) - document.skeleton.num_joints
        if carried:
            carrier = channels.read_channels(expected, hierarchy, "")
            back = kinematics.quaternion_conjugate(carrier.rotations[:, 0].astype(np.float64))
            rotations[:, 0] = kinematics.quaternion_multiply(back, rotations[:, 0])
            root = places[:, 0] - carrier.root * document.body.unit_metres
            places[:, 0] = kinematics.quaternion_rotate(back, root)
        rows, metres = expected.copy(), document.body.unit_metres
        for place, joint in enumerate(placed):
            for axis, column in hierarchy.joints[joint + carried].position_columns.items():
                value = places[:, place, axis] / metres
                close = np.abs(value - expected[:, column]) * metres < _SAME_METRES
                rows[:, column] = np.where(close, expected[:, column], value)
        for order, members in channels.joints_by_order(hierarchy).items():
            joints = [joint for joint in members if joint >= carried]
            columns = np.array([hierarchy.joints[joint].rotation_columns for joint in joints], int)
            rows[:, columns] = channels.anchored_angles(
                rotations[:, [joint - carried for joint in joints]],
                order,
                expected[:, columns],
                anchors[:, columns],
                after,
            )
        return rows


def _places(
    rotations: Float64[np.ndarray, "times joints 4"],
    positions: Float64[np.ndarray, "times joints 3"],
    skeleton: Skeleton,
    joints: tuple[int, ...],
) -> Float64[np.ndarray, "times placed 3"]:
    # Positions of joints in their parent's frame; the root's in the world.
    world = kinematics.global_rotations(rotations, skeleton)
    places = positions[:, list(joints)]
    for column, joint in enumerate(joints):
        parent = skeleton.parents[joint]
        if parent >= 0:
            back = kinematics.quaternion_conjugate(world[:, parent])
            places[:, column] = kinematics.quaternion_rotate(back, positions[:, joint] - positions[:, parent])
    return places


FORMAT = Format(
    name="bvh",
    read=of_path(read_bvh),
    document=read_document,
    suffixes=(".bvh",),
    begins=b"HIERARCHY",
    write=write_bvh,
    turns_up=True,
)
