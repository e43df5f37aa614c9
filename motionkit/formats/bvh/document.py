"""A BVH file that is to be written again: its hierarchy and its lines as they stand, and new frames between them.

`read_bvh` makes a motion of a file and forgets how it was written. Here nothing is forgotten: joints, channels, units
and axes stay the file's, given frames stay its own lines (`channel_lines` turns poses back into its channels). And
nothing is held: frames are read where they are needed, so a file of any length needs the memory of a short one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64, Int64

from motionkit.core import kinematics
from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion, Provenance
from motionkit.core.skeleton import Skeleton
from motionkit.core.skeletons.families import with_layout_map
from motionkit.core.timegrid import TimeGrid
from motionkit.fields.motion_field import Poses
from motionkit.formats.bvh import channels
from motionkit.formats.bvh.channels import anchored_angles
from motionkit.formats.bvh.frame_lines import FrameLines, checked_seen, find_frame_lines
from motionkit.formats.bvh.text import BvhHierarchy, read_head, stated_fps
from motionkit.formats.scan.items import ReadOptions
from motionkit.formats.source import body_frame, clock, number_table
from motionkit.formats.source.source_file import FileParts


@dataclass(frozen=True, eq=False)
class BvhDocument:
    """A file's text, and where in it the frames are of the motion that it describes.

    `frames` are its lines and their numbers (file units, degrees). The motion has every joint of the file, metres and y
    up; a body that the file has along z is `turned`. `reference` is the T-pose line that some conversions begin with,
    no frame.
    """

    path: Path
    head: bytes
    frame_time: str
    hierarchy: BvhHierarchy
    frames: FrameLines
    timegrid: TimeGrid
    skeleton: Skeleton
    unit_metres: float
    turned: bool
    reference: tuple[bytes, ...]
    provenance: Provenance

    @property
    def seen(self) -> Bool[np.ndarray, "frames"]:
        """Which frames have numbers that are all finite; the others repeat a neighbour."""
        return self.frames.seen

    def poses(self, frames: Int64[np.ndarray, "rows"]) -> Poses:
        """The poses of some frames, with rotations and the root's translation."""
        return _poses(self.frames.table(frames), self.hierarchy, self.skeleton, self.unit_metres, self.turned)

    def motion(self) -> Motion:
        """All of it, in memory."""
        poses = self.poses(np.arange(len(self.frames)))
        return replace(poses.at(self.timegrid, self.skeleton, self.provenance), sequence_id=self.path.stem)

    def heading(self, num_frames: int, fps: Fraction) -> bytes:
        """Everything before the first frame, for another number of frames and framerate."""
        frame_time = self.frame_time if fps == self.timegrid.fps else repr(float(1 / fps))
        told = f"\nFrames: {num_frames + len(self.reference)}\nFrame Time: {frame_time}\n"
        return (
            self.head.rstrip().replace(b"\r\n", b"\n")
            + told.encode()
            + b"".join(line + b"\n" for line in self.reference)
        )


def read_document(path: Path, options: ReadOptions | None = None) -> BvhDocument:
    """Look through a BVH file that is to be written again; raises `FormatError` as `read_bvh` does, but for two things.

    Frames that hold `nan` are not `seen`, and a skeleton that is no human body in any unit is taken as it is.
    """
    options = options or ReadOptions()
    file = FileParts.of(path)
    head = read_head(file)
    fps, operations = clock.fps_in_use(options.fps, lambda: stated_fps(head, path))
    _check_orders(head.hierarchy, path)
    frames = find_frame_lines(file, head)
    reference: tuple[bytes, ...] = ()
    if channels.starts_with_t_pose(frames.table(np.arange(min(2, len(frames)))), head.hierarchy):
        reference, frames = (frames.line(0),), frames.without_first()
        checked_seen(frames.seen, path)
        operations.append("frame 0 is a T-pose: kept in front, no part of the motion")
    skeleton, unit = _skeleton(frames, head.hierarchy, options, path)
    turned = _is_along_z(frames, head.hierarchy, skeleton, unit)
    return BvhDocument(
        path=path,
        head=head.head,
        frame_time=head.frame_time,
        hierarchy=head.hierarchy,
        frames=frames,
        timegrid=TimeGrid(fps, len(frames)),
        skeleton=body_frame.skeleton_to_y_up(skeleton) if turned else skeleton,
        unit_metres=unit,
        turned=turned,
        reference=reference,
        provenance=Provenance(
            source_path=path.name,
            source_sha256=file.sha256(),
            source_format="bvh",
            stated_fps=f"Frame Time: {head.frame_time}",
            operations=tuple(operations),
        ),
    )


def _check_orders(hierarchy: BvhHierarchy, path: Path) -> None:
    for joint in hierarchy.joints:
        if any(first == second for first, second in pairwise(joint.order)):
            message = (
                f"joint {joint.name!r} turns twice in a row about one axis ({joint.order}): its angles are not unique"
            )
            raise FormatError(message, path=path, reason="channels")


def _skeleton(frames: FrameLines, hierarchy: BvhHierarchy, options: ReadOptions, path: Path) -> tuple[Skeleton, float]:
    # In metres, along the file's axes; bones as in the first frame say which unit it is.
    pose = channels.read_channels(frames.table(np.arange(1)), hierarchy, path.stem)
    skeleton = with_layout_map(pose.skeleton, options.skeleton_maps)
    inferred = body_frame.infer_unit(channels.first_skeleton(replace(pose, skeleton=skeleton)))
    unit = options.unit_metres or (inferred.metres if inferred else 1.0)
    return skeleton.scaled(unit), unit


def _is_along_z(frames: FrameLines, hierarchy: BvhHierarchy, skeleton: Skeleton, unit: float) -> bool:
    # Few rest poses lie along z: only for those all frames are asked.
    if not body_frame.rests_along_z(skeleton):
        return False
    total = np.zeros((skeleton.num_joints, 3))
    for table in frames.tables():
        total += _poses(table, hierarchy, skeleton, unit, turned=False).joint_positions.sum(axis=0, dtype=np.float64)
    return body_frame.stands_along_z(skeleton, (total / len(frames)).astype(np.float32))


def _poses(
    table: Float64[np.ndarray, "frames channels"],
    hierarchy: BvhHierarchy,
    skeleton: Skeleton,
    unit: float,
    turned: bool,
) -> Poses:
    pose = channels.read_channels(table, hierarchy, skeleton.name)
    rotations, root = np.ascontiguousarray(pose.rotations), (pose.root * unit).astype(np.float32)
    written = pose.skeleton.scaled(unit)
    offsets = np.repeat(written.offsets[None], len(root), axis=0)
    offsets[:, list(pose.placed_joints)] = pose.places * unit
    positions = kinematics.forward_kinematics(rotations, root, written, offsets)
    if turned:
        _, positions, rotations, root = body_frame.z_up_to_y_up(written, positions, rotations, root)
    return Poses(positions, rotations, root)


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
