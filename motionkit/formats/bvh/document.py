"""A BVH file that is to be written again: its hierarchy and its lines as they stand, and new frames between them.

`read_bvh` makes a motion of a file and forgets how it was written. Here nothing is forgotten: joints, channels, units
and axes stay the file's, given frames stay its own lines, and poses are turned back into its channels.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64, Int64

from motionkit import kinematics
from motionkit.errors import FormatError
from motionkit.formats import body_frame, clock, number_table, sourcefile
from motionkit.formats.bvh import channels as bvh_channels
from motionkit.formats.bvh.euler import anchored_angles
from motionkit.formats.bvh.hierarchy import BvhHierarchy
from motionkit.formats.bvh.text import split_text, stated_fps
from motionkit.formats.items import ReadOptions
from motionkit.motion import Motion, Provenance
from motionkit.motionfield import Poses
from motionkit.skeleton import Skeleton
from motionkit.skeleton_families import with_layout_map
from motionkit.timegrid import TimeGrid

WRITTEN_DECIMALS = 6
# Places that differ by less from what is expected are as good: positions are float32.
_SAME_METRES = 2e-6
_FRAMES_AT_ONCE = 4096


@dataclass(frozen=True, eq=False)
class BvhDocument:
    """A file's text and numbers, and the motion that they describe.

    `lines` are the frames as written, `table` their numbers (file units, degrees). `motion` has every joint of the
    file, metres and y up; a body that the file has along z is `turned`. `seen` marks the frames whose numbers are all
    finite: the others repeat a neighbour. `reference` is the T-pose line that some conversions begin with, no frame.
    """

    path: Path
    head: bytes
    frame_time: str
    hierarchy: BvhHierarchy
    lines: tuple[bytes, ...]
    table: Float64[np.ndarray, "frames channels"]
    motion: Motion
    seen: Bool[np.ndarray, "frames"]
    unit_metres: float
    turned: bool
    reference: tuple[bytes, ...]

    def heading(self, num_frames: int, fps: Fraction) -> bytes:
        """Everything before the first frame, for another number of frames and framerate."""
        frame_time = self.frame_time if fps == self.motion.fps else repr(float(1 / fps))
        told = f"\nFrames: {num_frames + len(self.reference)}\nFrame Time: {frame_time}\n"
        return (
            self.head.rstrip().replace(b"\r\n", b"\n")
            + told.encode()
            + b"".join(line + b"\n" for line in self.reference)
        )


def read_document(path: Path, options: ReadOptions | None = None) -> BvhDocument:
    """Read a BVH file so that it can be written again; raises `FormatError` as `read_bvh` does, but for two things.

    Frames that hold `nan` are not `seen`, and a skeleton that is no human body in any unit is taken as it is.
    """
    options = options or ReadOptions()
    data = sourcefile.read_bytes(path)
    file, sha256 = split_text(data, path), sourcefile.sha256(data)
    fps, operations = clock.fps_in_use(options.fps, lambda: stated_fps(file, path))
    del data
    _check_orders(file.hierarchy, path)
    body, seen = _without_nan(file.body, file.num_frames, path)
    columns = file.hierarchy.num_channels
    table = number_table.parse_table(
        body, num_rows=file.num_frames, num_columns=columns, path=path, first_line=file.body_line
    )
    lines = tuple(line.strip() for line in file.body.splitlines() if line.strip())
    reference: tuple[bytes, ...] = ()
    if bvh_channels.starts_with_t_pose(table, file.hierarchy):
        reference, lines, table, seen = lines[:1], lines[1:], table[1:], seen[1:]
        operations.append("frame 0 is a T-pose: kept in front, no part of the motion")
    motion, unit, turned = _motion(table, file.hierarchy, fps, options, path)
    provenance = Provenance(
        source_path=path.name,
        source_sha256=sha256,
        source_format="bvh",
        stated_fps=f"Frame Time: {file.frame_time}",
        operations=tuple(operations),
    )
    return BvhDocument(
        path=path,
        head=file.head,
        frame_time=file.frame_time,
        hierarchy=file.hierarchy,
        lines=lines,
        table=table,
        motion=replace(motion, provenance=provenance),
        seen=seen,
        unit_metres=unit,
        turned=turned,
        reference=reference,
    )


def _check_orders(hierarchy: BvhHierarchy, path: Path) -> None:
    for joint in hierarchy.joints:
        if any(first == second for first, second in pairwise(joint.order)):
            message = (
                f"joint {joint.name!r} turns twice in a row about one axis ({joint.order}): its angles are not unique"
            )
            raise FormatError(message, path=path, reason="channels")


def _without_nan(body: bytes, num_frames: int, path: Path) -> tuple[bytes, Bool[np.ndarray, "frames"]]:
    """The lines, those that hold `nan` replaced by the one before (or the first that has none), and which have none."""
    is_nan = re.compile(rb"(?i)(?<![^\s])[-+]?nan(?![^\s])")
    if is_nan.search(body) is None:
        return body, np.ones(num_frames, bool)
    lines = [line for line in body.splitlines() if line.strip()]
    seen = np.array([is_nan.search(line) is None for line in lines], bool)
    if not seen.any():
        raise FormatError("every frame holds nan: nothing is observed", path=path, reason="nan")
    source = np.maximum.accumulate(np.where(seen, np.arange(len(lines)), int(np.argmax(seen))))
    return b"\n".join(lines[row] for row in source.tolist()) + b"\n", seen


def _motion(
    table: Float64[np.ndarray, "frames channels"],
    hierarchy: BvhHierarchy,
    fps: Fraction,
    options: ReadOptions,
    path: Path,
) -> tuple[Motion, float, bool]:
    pose = bvh_channels.read_channels(table, hierarchy, path.stem)
    skeleton = with_layout_map(pose.skeleton, options.skeleton_maps)
    inferred = body_frame.infer_unit(bvh_channels.first_skeleton(replace(pose, skeleton=skeleton)))
    unit = options.unit_metres or (inferred.metres if inferred else 1.0)
    skeleton = skeleton.scaled(unit)
    rotations, root = np.ascontiguousarray(pose.rotations), (pose.root * unit).astype(np.float32)
    positions = np.empty((len(root), skeleton.num_joints, 3), np.float32)
    for start in range(0, len(root), _FRAMES_AT_ONCE):  # what it needs is several times what it gives
        some = slice(start, start + _FRAMES_AT_ONCE)
        offsets = np.repeat(skeleton.offsets[None], len(root[some]), axis=0)
        offsets[:, list(pose.placed_joints)] = pose.places[some] * unit
        positions[some] = kinematics.forward_kinematics(rotations[some], root[some], skeleton, offsets)
    turned = body_frame.is_z_up(skeleton, positions)
    if turned:
        skeleton, positions, rotations, root = body_frame.z_up_to_y_up(skeleton, positions, rotations, root)
    grid = TimeGrid(fps, len(positions))
    return Motion(positions, skeleton, grid, rotations, root, sequence_id=path.stem), unit, turned


class ChannelLines:
    """Turns poses into lines of a document, in order of time; owns the last row, from which the next one goes on.

    `anchors` are the document's frames that are known, ascending.
    """

    def __init__(self, document: BvhDocument, anchors: Int64[np.ndarray, "anchors"]) -> None:
        self._document = document
        self._frames = anchors
        self._known_seconds = document.motion.timegrid.seconds()[anchors]
        self._last_row: Float64[np.ndarray, "1 channels"] | None = None
        self._last_after = -1

    def lines(
        self,
        seconds: Float64[np.ndarray, "times"],
        poses: Poses,
        given: Sequence[int | None],
    ) -> Iterator[bytes]:
        """The lines of consecutive frames; those `given` by number are the document's own.

        All frames before the first known one have to come in one call, the first.
        """
        rows = self._rows(seconds, poses)
        for place, frame in enumerate(given):
            if frame is not None:
                rows[place] = self._document.table[frame]
        self._last_row = rows[-1:]
        made = number_table.format_table(np.round(rows, WRITTEN_DECIMALS) + 0.0).splitlines()
        for line, frame in zip(made, given, strict=True):
            yield line if frame is None else self._document.lines[frame]

    def _rows(self, seconds: Float64[np.ndarray, "times"], poses: Poses) -> Float64[np.ndarray, "times channels"]:
        known = self._known_seconds
        after = np.searchsorted(known, seconds + 1e-9, side="right") - 1
        leading = after < 0
        expected = self._expected(seconds)
        if leading.any():
            back = np.flatnonzero(leading)[::-1]
            rows = np.empty_like(expected)
            rows[back] = self._converted(
                poses.rows(back), expected[back], self._document.table[self._frames[:1]], np.zeros_like(after[back])
            )
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
        known = self._document.table[self._frames[first : int(after[-1]) + 1]]
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
        before, behind = (self._document.table[self._frames[places]] for places in (left, right))
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
        skeleton = document.motion.skeleton
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
