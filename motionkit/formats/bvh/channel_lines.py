"""Poses turned back into the lines of a BVH file: its own channels, units and axes, angles that go on from its own."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64, Int64

from motionkit import kinematics
from motionkit.formats import number_table
from motionkit.formats.bvh.document import BvhDocument
from motionkit.formats.bvh.euler import anchored_angles
from motionkit.formats.bvh.hierarchy import BvhHierarchy
from motionkit.motionfield import Poses
from motionkit.skeleton import Skeleton

WRITTEN_DECIMALS = 6
# Places that differ by less from what is expected are as good: positions are float32.
_SAME_METRES = 2e-6


class ChannelLines:
    """Turns poses into lines of a document, in order of time; owns the last row, from which the next one goes on.

    `anchors` are the document's frames that are known, ascending, and `seconds` when they were.
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
        """The lines of consecutive frames; `given_rows` of them are `given_frames` of the document, as written there.

        All frames before the first known one have to come in one call, the first.
        """
        rows = self._rows(seconds, poses)
        rows[given_rows] = self._document.frames.table(given_frames)
        self._last_row = rows[-1:].copy()
        made = number_table.format_table(np.round(rows, WRITTEN_DECIMALS) + 0.0).splitlines()
        for row, frame in zip(given_rows.tolist(), given_frames.tolist(), strict=True):
            made[row] = self._document.frames.line(frame)
        return made

    def _rows(self, seconds: Float64[np.ndarray, "times"], poses: Poses) -> Float64[np.ndarray, "times channels"]:
        known = self._known_seconds
        after = np.searchsorted(known, seconds + 1e-9, side="right") - 1
        leading = after < 0
        expected = self._expected(seconds)
        if leading.any():
            back = np.flatnonzero(leading)[::-1]
            rows = np.empty_like(expected)
            first_known = self._document.frames.table(self._frames[:1])
            rows[back] = self._converted(poses.rows(back), expected[back], first_known, np.zeros_like(after[back]))
            rest = np.flatnonzero(~leading)
            if rest.size:
                rows[rest] = self._converted(poses.rows(rest), expected[rest], *self._anchors(after[rest]))
            return rows
        return self._converted(poses, expected, *self._anchors(after))

    def _anchors(
        self, after: Int64[np.ndarray, "times"]
    ) -> tuple[Float64[np.ndarray, "anchors channels"], Int64[np.ndarray, "times"]]:
        # The known rows that count here; a stretch that began in the call before goes on from its last row.
        first, goes_on = int(after[0]), self._last_row is not None and self._last_after == after[0]
        known = self._document.frames.table(self._frames[first : int(after[-1]) + 1])
        if goes_on and self._last_row is not None:
            known[0] = self._last_row[0]
        self._last_after = int(after[-1])
        return known, after - first

    def _expected(self, seconds: Float64[np.ndarray, "times"]) -> Float64[np.ndarray, "times channels"]:
        # Channels on straight lines between known frames, and at rest beyond them.
        known = self._known_seconds
        left = np.clip(np.searchsorted(known, seconds, side="right") - 1, 0, max(0, len(known) - 2))
        right = np.minimum(left + 1, len(known) - 1)
        span = np.where(right > left, known[right] - known[left], 1.0)
        fraction = np.clip((seconds - known[left]) / span, 0.0, 1.0)[:, None]
        before, behind = (self._document.frames.table(self._frames[places]) for places in (left, right))
        return np.asarray(before + fraction * (behind - before))

    def _converted(
        self,
        poses: Poses,
        expected: Float64[np.ndarray, "times channels"],
        anchors: Float64[np.ndarray, "anchors channels"],
        after: Int64[np.ndarray, "times"],
    ) -> Float64[np.ndarray, "times channels"]:
        document = self._document
        assert poses.local_rotations is not None
        skeleton = document.skeleton
        rotations = poses.local_rotations.astype(np.float64)
        positions = poses.joint_positions.astype(np.float64)
        rows = expected.copy()
        placed = [joint for joint, each in enumerate(document.hierarchy.joints) if each.position_columns]
        if placed:
            places = _places(rotations, positions, skeleton, placed)
            if document.turned:
                places = _turned_back(places)
            places /= document.unit_metres
            for column_of, joint in enumerate(placed):
                for axis, column in document.hierarchy.joints[joint].position_columns.items():
                    value = places[:, column_of, axis]
                    close = np.abs(value - expected[:, column]) * document.unit_metres < _SAME_METRES
                    rows[:, column] = np.where(close, expected[:, column], value)
        if document.turned:
            rotations = np.concatenate((rotations[..., :1], _turned_back(rotations[..., 1:])), axis=-1)
        for order, joints in _by_order(document.hierarchy).items():
            columns = np.array([document.hierarchy.joints[joint].rotation_columns for joint in joints])
            rows[:, columns] = anchored_angles(
                rotations[:, joints], order, expected[:, columns], anchors[:, columns], after
            )
        return rows


def _places(
    rotations: Float64[np.ndarray, "times joints 4"],
    positions: Float64[np.ndarray, "times joints 3"],
    skeleton: Skeleton,
    joints: Sequence[int],
) -> Float64[np.ndarray, "times placed 3"]:
    # Where joints are in their parent's frame; the root, in the world.
    world = kinematics.global_rotations(rotations, skeleton)
    places = positions[:, joints].copy()
    for column, joint in enumerate(joints):
        parent = skeleton.parents[joint]
        if parent >= 0:
            back = kinematics.quaternion_conjugate(world[:, parent])
            places[:, column] = kinematics.quaternion_rotate(back, positions[:, joint] - positions[:, parent])
    return places


def _turned_back(vectors: Float64[np.ndarray, "*shape 3"]) -> Float64[np.ndarray, "*shape 3"]:
    # The inverse of body_frame.turn_to_y_up: (x, y, z) → (x, −z, y).
    return np.asarray(vectors[..., [0, 2, 1]] * np.array([1.0, -1.0, 1.0]))


def _by_order(hierarchy: BvhHierarchy) -> dict[str, list[int]]:
    orders: dict[str, list[int]] = {}
    for joint, each in enumerate(hierarchy.joints):
        if each.order:
            orders.setdefault(each.order, []).append(joint)
    return orders
