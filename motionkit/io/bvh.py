"""BVH (BioVision Hierarchy): a text file of joints with offsets and channels, then one line of numbers per frame.

Channels are degrees and file units; a joint's rotation is the product of its rotation channels in the order in which
they are listed; position channels replace the joint's OFFSET. Source: M. Meredith and S. Maddock, "Motion Capture File
Formats Explained", University of Sheffield CS-01-11, 2001.

`read_bvh` reads a file's motion. `read_document` also keeps its text, its lines and its numbers, from which
`bvh_writing` writes the file again.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion
from motionkit.core.shapes import Bool, Float, Float32, Float64, Int64
from motionkit.core.skeleton import MAX_JOINTS, Skeleton
from motionkit.core.skeletons.mapping import SkeletonMapError, body_axis, rest_positions, with_layout_map
from motionkit.core.timegrid import TimeGrid, parse_fps
from motionkit.io import body_frame, number_table, source_file
from motionkit.io.body_frame import infer_up, log_lines, skeleton_to_y_up, to_y_up, turn_of
from motionkit.io.number_table import parse_number
from motionkit.io.registry import Format, ReadOptions, of_path

if TYPE_CHECKING:
    from motionkit.fields.motion_field import Poses

CHANNELS = {f"{axis}{kind}": (axis, kind) for axis in "XYZ" for kind in ("position", "rotation")}
# Smaller changes of a bone are noise of printed digits; a bone with larger ones is not rigid.
RIGID_METRES = 1e-3
# The log line by which readers of data sets know that frame numbers are shifted by one.
T_POSE_DROPPED = "frame 0 dropped: a T-pose (root unturned, all angles whole degrees, root where frame 1 is)"
# Bones are longer than this, relative to their OFFSET.
NO_BONE = 1e-3
# The arrays of so many frames fit into a core's cache.
BLOCK_FRAMES = 4096
LARGEST_HEAD_BYTES = 64 << 20
# Of blank lines at the end of a file.
LONGEST_END_BYTES = 1 << 16
_MOTION = re.compile(rb"(?m)^[ \t]*MOTION[ \t]*\r?$")
_NAN = re.compile(rb"(?i)(?<![^\s])[-+]?nan(?![^\s])")
_BLANK = bytes(range(33))


@dataclass
class BvhJoint:
    """A joint as written: `position_columns` maps an axis 0…2 to its column, `rotation_columns` are in `order`."""

    name: str
    parent: int
    offset: tuple[float, float, float] | None = None
    position_columns: dict[int, int] = field(default_factory=dict)
    rotation_columns: list[int] = field(default_factory=list)
    order: str = ""
    end_site: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class BvhHierarchy:
    """The joints in file order (parents first) and the number of channels of one frame."""

    joints: tuple[BvhJoint, ...]
    num_channels: int

    def joints_by_order(self) -> dict[str, list[int]]:
        """The joints with rotation channels, by the order of their axes."""
        orders: dict[str, list[int]] = {}
        for index, joint in enumerate(self.joints):
            if joint.order:
                orders.setdefault(joint.order, []).append(index)
        return orders


@dataclass(frozen=True)
class BvhHead:
    """The lines before the numbers: `text` ends with the word MOTION, the numbers begin in line `body_line`."""

    text: bytes
    hierarchy: BvhHierarchy
    num_frames: int
    frame_time: str
    frame_time_line: int
    body_line: int


@dataclass(frozen=True, eq=False)
class BvhDocument:
    """A BVH file in memory: its motion, and the text and numbers from which it can be written again.

    Frame k of the motion is `lines[k]` of the file as written, and row k of `table` (file units and degrees). `valid`
    marks the frames whose numbers are all finite; the others repeat the frame before, or the first valid one. `body` is
    the text of all lines of numbers, in which the motion begins with line `first_frame` (from 0). `has_reference` is
    whether line 0 is the T-pose that some conversions begin with, which is not a frame. `local_rotations` and
    `root_translation` are also those of a file whose bones change, which its motion lacks.

    `moving` are the joints that move relative to their parents. `up` is the axis of the file that points up, and
    `rest_has_same_up` whether it also points up in the rest pose; if not, the rest pose is y up.
    """

    path: Path
    motion: Motion
    local_rotations: Float32[np.ndarray, "frames joints 4"]
    root_translation: Float32[np.ndarray, "frames 3"]
    head: BvhHead
    body: bytes
    first_frame: int
    has_reference: bool
    table: Float64[np.ndarray, "frames channels"]
    valid: Bool[np.ndarray, "frames"]
    unit_metres: float
    moving: tuple[int, ...]
    up: str
    rest_has_same_up: bool

    @cached_property
    def lines(self) -> list[bytes]:
        """The line of each frame as written, without white space around it."""
        return _lines(self.body)[self.first_frame : self.first_frame + len(self.table)]

    @property
    def poses(self) -> "Poses":
        """All poses, with rotations and the root's translation."""
        from motionkit.fields.motion_field import Poses  # reading a file loads no motion fields

        return Poses(self.motion.joint_positions, self.local_rotations, self.root_translation)

    def frames(self, start: int, stop: int) -> "BvhDocument":
        """Frames [start, stop), at their own times."""
        return replace(
            self,
            motion=self.motion.frames(start, stop),
            local_rotations=self.local_rotations[start:stop],
            root_translation=self.root_translation[start:stop],
            first_frame=self.first_frame + start,
            table=self.table[start:stop],
            valid=self.valid[start:stop],
        )

    def heading(self, num_frames: int, fps: Fraction) -> bytes:
        """Everything before the first frame, for another number of frames and framerate."""
        frame_time = self.head.frame_time if fps == self.motion.fps else repr(float(1 / fps))
        clock_lines = f"\nFrames: {num_frames + self.has_reference}\nFrame Time: {frame_time}\n"
        reference = _lines(self.body)[0] + b"\n" if self.has_reference else b""
        return self.head.text.rstrip().replace(b"\r\n", b"\n") + clock_lines.encode() + reference


def read_bvh(path: Path, options: ReadOptions | None = None) -> Motion:
    """Read one BVH file: positions in metres, y up, true local rotations, at the stated framerate.

    The unit is `options.unit_metres` or inferred (`body_frame.infer_unit`); a T-pose in frame 0, as B. Hahne's
    conversions of the CMU database have it, is dropped; a motion that is not y up is turned (`body_frame.infer_up`).
    All of this is in the operation log. Raises `FormatError` with a reason, the line and the frame.
    """
    return _read(path, options or ReadOptions(), allow_nan=False, any_size=False).motion


def read_document(path: Path, options: ReadOptions | None = None) -> BvhDocument:
    """Read one BVH file to be written again; raises `FormatError` as `read_bvh` does, with two exceptions.

    Frames with `nan` are not `valid`, and a skeleton that is not a human body in any unit is accepted.
    """
    return _read(path, options or ReadOptions(), allow_nan=True, any_size=True)


def _read(path: Path, options: ReadOptions, *, allow_nan: bool, any_size: bool) -> BvhDocument:
    data = source_file.read_bytes(path)
    # Lines of old Macintoshes end in a carriage return alone.
    head, body = split_text(data if b"\n" in data else data.replace(b"\r", b"\n"), path)
    provenance = source_file.provenance(path, data, "bvh", (), stated_fps=f"Frame Time: {head.frame_time}")
    del data  # before the memory of the numbers is needed
    hierarchy = head.hierarchy
    fps, operations = source_file.fps_in_use(options.fps, lambda: _stated_fps(head, path))
    # A number takes at least a digit and a separator: a shorter text is truncated, which its last line says.
    if 2 * head.num_frames * hierarchy.num_channels - 1 <= len(body):
        source_file.check_size(head.num_frames, len(hierarchy.joints), path)
    has_nan = allow_nan and _NAN.search(body) is not None
    numbers = body
    if has_nan:  # zeros keep the counts of lines and frames right
        zeros = b" ".join([b"0"] * hierarchy.num_channels)
        numbers = b"\n".join(zeros if _NAN.search(line) else line for line in body.split(b"\n"))
    table = number_table.read_table(numbers, head.num_frames, hierarchy.num_channels, path, head.body_line)
    valid = np.ones(len(table), bool)
    if has_nan:
        valid = np.array([_NAN.search(line) is None for line in _lines(body)], bool)
    has_reference = bool(valid[:2].all()) and _starts_with_t_pose(table, hierarchy)
    if has_reference:
        table, valid = table[1:], valid[1:]
        operations.append(T_POSE_DROPPED)
    if not valid.all():
        table = table[_last_valid(valid, path)]
    pose = _decode(table, hierarchy, path.stem)
    pose = replace(pose, skeleton=with_layout_map(pose.skeleton, options.skeleton_maps))
    unit_metres, reason = _unit(pose, options, path, any_size)
    skeleton, moving = _settle_offsets(pose, RIGID_METRES / unit_metres)
    operations += [*pose.operations, f"lengths × {unit_metres:.6g} to metres ({reason})"]
    if moving:
        names = ", ".join(skeleton.joint_names[joint] for joint in moving)
        operations.append(f"positions only: these bones change their length or place ({names})")
    skeleton = skeleton.scaled(unit_metres)
    root = (pose.root * unit_metres).astype(np.float32)
    positions = _positions(pose, root, skeleton, moving, unit_metres)
    up, rest_has_same_up = _up(skeleton, positions, options.up)
    operations += log_lines(up, options.up)
    rotations = pose.rotations
    if up != "y":
        positions, root = to_y_up(positions, up), to_y_up(root, up)
        if rest_has_same_up:
            skeleton = skeleton_to_y_up(skeleton, up)
            rotations[..., 1:] = to_y_up(rotations[..., 1:], up)
        else:
            rotations[:, 0] = kinematics.quaternion_multiply(turn_of(up), rotations[:, 0])
    motion = Motion(
        positions,
        skeleton,
        TimeGrid(fps, len(table)),
        local_rotations=None if moving else rotations,
        root_translation=None if moving else root,
        sequence_id=path.stem,
        provenance=replace(provenance, operations=tuple(operations)),
    )
    return BvhDocument(
        path=path,
        motion=motion,
        local_rotations=rotations,
        root_translation=root,
        head=head,
        body=body,
        first_frame=int(has_reference),
        has_reference=has_reference,
        table=table,
        valid=valid,
        unit_metres=unit_metres,
        moving=moving,
        up=up,
        rest_has_same_up=rest_has_same_up,
    )


def _lines(body: bytes) -> list[bytes]:
    return [stripped for line in body.split(b"\n") if (stripped := line.strip(_BLANK))]


def _last_valid(valid: Bool[np.ndarray, "frames"], path: Path) -> Int64[np.ndarray, "frames"]:
    """For each frame the last valid one up to it; the first valid one before that."""
    if not valid.any():
        raise FormatError("every frame holds nan: nothing is observed", path=path, reason="nan")
    return np.asarray(np.maximum.accumulate(np.where(valid, np.arange(len(valid)), int(np.argmax(valid)))))


def _unit(pose: "_ChannelPose", options: ReadOptions, path: Path, any_size: bool) -> tuple[float, str]:
    if options.unit_metres is not None:
        return options.unit_metres, "given"
    unit = body_frame.infer_unit(_first_skeleton(pose))
    if unit is not None:
        return unit.metres, unit.reason
    if any_size:
        return 1.0, "in no unit the size of a human body"
    raise FormatError(
        "in none of m, cm, mm, inch and the CMU database's unit is this skeleton the size of a human body; "
        "say how long a unit is with --unit-metres",
        path=path,
        reason="unit",
    )


def _up(skeleton: Skeleton, positions: Float32[np.ndarray, "frames joints 3"], given: str) -> tuple[str, bool]:
    """The axis that is given, else inferred from the motion; and whether it is also the rest pose's.

    The rest pose's axis is the expected one: whole files are along z or x, or only their motion.
    """
    try:
        x, y, z = body_axis(skeleton, rest_positions(skeleton)[None])[0].tolist()
    except SkeletonMapError:
        return given or "y", True
    rest = "z" if z > 2.0 * abs(y) else "x" if x > 2.0 * abs(y) else "y"
    up = given or infer_up(skeleton, positions, ("z", "y") if rest == "z" else ("y", "z"))
    return up, up == rest


def split_text(data: bytes, path: Path) -> tuple[BvhHead, bytes]:
    """A file's head and its lines of numbers, without blank lines at the end. Lines must end in newlines.

    Raises `FormatError` naming the line where something is missing, or if it is not a BVH file.
    """
    if not data[:4096].removeprefix(b"\xef\xbb\xbf").lstrip()[:9].upper().startswith(b"HIERARCHY"):
        raise FormatError(
            f"looks like {source_file.describe_content(data)}, expected a BVH file that begins with HIERARCHY",
            path=path,
            reason="not-what-it-says",
            line=1,
        )
    motion = _MOTION.search(data)
    end_of_hierarchy = motion.start() if motion else len(data)
    if end_of_hierarchy > LARGEST_HEAD_BYTES:
        message = f"no frames within the first {LARGEST_HEAD_BYTES >> 20} MiB, expected a hierarchy and MOTION"
        raise FormatError(message, path=path, reason="too-large")
    hierarchy = parse_hierarchy(source_file.decode(data[:end_of_hierarchy], path), path)
    if motion is None:
        raise FormatError(
            f"the file ends after the hierarchy of {len(hierarchy.joints)} joints, expected MOTION",
            path=path,
            reason="truncated",
            line=data.count(b"\n") + 1,
        )
    if not hierarchy.num_channels:
        raise FormatError("no joint has CHANNELS, so nothing moves", path=path, reason="channels")
    clock_lines, body_start = _clock_lines(data, motion.end(), path)
    count, count_line = clock_lines["frames"]
    frame_time, frame_time_line = clock_lines["frame time"]
    if not (count.isascii() and count.isdecimal() and len(count) < 12):
        message = f"'Frames: {count[:40]}', expected a whole number"
        raise FormatError(message, path=path, reason="frame-count", line=count_line)
    if int(count) == 0:
        raise FormatError("0 frames, expected at least one", path=path, reason="no-frames", line=count_line)
    head = BvhHead(
        text=data[: motion.end()],
        hierarchy=hierarchy,
        num_frames=int(count),
        frame_time=frame_time,
        frame_time_line=frame_time_line,
        body_line=data.count(b"\n", 0, body_start) + 1,
    )
    end = data[-LONGEST_END_BYTES:]
    return head, data[body_start : len(data) - len(end) + len(end.rstrip())]


def _clock_lines(data: bytes, start: int, path: Path) -> tuple[dict[str, tuple[str, int]], int]:
    """The values of `frames` and `frame time` with their lines, and the offset at which the numbers begin."""
    values: dict[str, tuple[str, int]] = {}
    line = data.count(b"\n", 0, start)
    while len(values) < 2:
        line += 1
        end = data.find(b"\n", start)
        end = len(data) if end < 0 else end
        text = source_file.decode(data[start:end], path).strip()
        key, colon, value = text.partition(":")
        key = " ".join(key.lower().split())
        if colon and key in ("frames", "frame time"):
            values[key] = value.strip(), line
        elif text:
            missing = "Frame Time: seconds" if "frames" in values else "Frames: count"
            raise FormatError(
                f"{text[:40]!r} where '{missing}' was expected",
                path=path,
                reason="frame-time" if "frames" in values else "frame-count",
                line=line,
            )
        if end == len(data) and len(values) < 2:
            raise FormatError(
                "the file ends before its first frame, expected 'Frames:' and 'Frame Time:'",
                path=path,
                reason="truncated",
                line=line,
            )
        start = end + 1
    return values, start


def _stated_fps(head: BvhHead, path: Path) -> Fraction:
    try:
        return _fps_of(head.frame_time)
    except (ValueError, OverflowError) as error:
        raise FormatError(
            f"'Frame Time: {head.frame_time[:40]}' is not a usable time between frames in seconds ({error}); "
            "correct it, or give the framerate",
            path=path,
            reason="frame-time",
            line=head.frame_time_line,
        ) from None


@lru_cache(maxsize=256)  # a corpus has few different frame times
def _fps_of(frame_time: str) -> Fraction:
    seconds = float(frame_time)
    if not seconds > 0:
        raise ValueError("it must be positive")
    return parse_fps(1.0 / seconds)


def parse_hierarchy(text: str, path: Path) -> BvhHierarchy:
    """Read the lines from HIERARCHY up to MOTION; raises `FormatError` (`hierarchy`, `channels`) naming the line."""
    try:
        return cached_hierarchy(text)
    except FormatError as error:
        raise FormatError(error.message, path=path, reason=error.reason, line=error.line) from None


@lru_cache(maxsize=64)  # the takes of a corpus have identical hierarchies
def cached_hierarchy(text: str) -> BvhHierarchy:
    """`parse_hierarchy` of a file without a name."""
    return _HierarchyParser().parse(text)


class _HierarchyParser:
    def __init__(self) -> None:
        self.line = 0
        self.joints: list[BvhJoint] = []
        self.num_channels = 0
        self.open: list[int] = []  # joints whose braces are open; −1 stands for an End Site
        self.pending: int | None = None  # what the next "{" opens

    def parse(self, text: str) -> BvhHierarchy:
        for self.line, line in enumerate(text.splitlines(), start=1):
            for statement in map(str.strip, re.split(r"([{}])", line)):
                if statement:
                    self.statement(statement)
        if self.open or self.pending is not None:
            raise self.fault("the hierarchy ends inside a joint, expected '}'")
        if not self.joints:
            raise self.fault("no ROOT joint in the hierarchy")
        return BvhHierarchy(tuple(self.joints), self.num_channels)

    def fault(self, message: str, reason: str = "hierarchy") -> FormatError:
        return FormatError(message, path="", reason=reason, line=self.line)

    def statement(self, text: str) -> None:
        keyword, *words = text.split()
        match keyword.upper():
            case "HIERARCHY" if not self.joints:
                return
            case "ROOT" | "JOINT":
                self.begin_joint(keyword.upper(), text[len(keyword) :].strip())
            case "END":
                if not self.open or self.open[-1] < 0:
                    raise self.fault("an End Site outside a joint")
                self.pending = -1
            case "{":
                if self.pending is None:
                    raise self.fault("'{' without a joint before it")
                self.open.append(self.pending)
                self.pending = None
            case "}":
                if not self.open or self.pending is not None:
                    raise self.fault("'}' without a '{' before it")
                joint = self.open.pop()
                if joint >= 0 and self.joints[joint].offset is None:
                    raise self.fault(f"joint {self.joints[joint].name!r} has no OFFSET")
            case "OFFSET":
                self.offset(words)
            case "CHANNELS":
                self.channels(words)
            case _:
                raise self.fault(f"{text[:40]!r}, expected ROOT, JOINT, End Site, OFFSET, CHANNELS, '{{' or '}}'")

    def begin_joint(self, keyword: str, name: str) -> None:
        # A name may hold spaces and colons.
        if self.pending is not None or (keyword == "JOINT") != bool(self.open) or (self.open and self.open[-1] < 0):
            where = "inside the ROOT" if keyword == "JOINT" else "once, as the outermost joint"
            raise self.fault(f"{keyword} {name!r} is out of place: a {keyword} belongs {where}")
        if keyword == "ROOT" and self.joints:
            raise self.fault(f"a second ROOT {name!r}: one skeleton to a file is expected")
        if len(self.joints) >= MAX_JOINTS:
            raise self.fault(f"more than {MAX_JOINTS} joints")
        self.joints.append(BvhJoint(name or f"joint{len(self.joints)}", self.open[-1] if self.open else -1))
        self.pending = len(self.joints) - 1

    def offset(self, words: list[str]) -> None:
        if not self.open or self.pending is not None:
            raise self.fault("OFFSET outside a joint")
        if len(words) != 3:
            raise self.fault(f"OFFSET with {len(words)} numbers, expected 3")
        x, y, z = (parse_number(word, Path(), self.line) for word in words)
        if self.open[-1] >= 0:
            self.joints[self.open[-1]].offset = (x, y, z)
        else:
            owner = self.joints[self.open[-2]]
            owner.end_site = owner.end_site or (x, y, z)

    def channels(self, words: list[str]) -> None:
        if not self.open or self.open[-1] < 0 or self.pending is not None:
            raise self.fault("CHANNELS outside a joint", "channels")
        joint = self.joints[self.open[-1]]
        if joint.order or joint.position_columns:
            raise self.fault(f"joint {joint.name!r} has CHANNELS twice", "channels")
        if not words or words[0] != str(len(words) - 1):
            raise self.fault(f"CHANNELS {' '.join(words)[:60]!r}: expected a count and that many names", "channels")
        for word in words[1:]:
            axis, kind = CHANNELS.get(word.capitalize(), ("", ""))
            if not axis or (kind == "position" and "XYZ".index(axis) in joint.position_columns):
                raise self.fault(f"channel {word!r}: expected each of {', '.join(CHANNELS)} at most once", "channels")
            if kind == "position":
                joint.position_columns["XYZ".index(axis)] = self.num_channels
            else:
                joint.rotation_columns.append(self.num_channels)
                joint.order += axis
            self.num_channels += 1
        if len(joint.order) > 3:
            message = f"joint {joint.name!r} has {len(joint.order)} rotation channels, expected at most 3"
            raise self.fault(message, "channels")


@dataclass(frozen=True)
class _ChannelPose:
    """The decoded channels. `places` are the offsets that position channels give to `placed_joints` below the root."""

    skeleton: Skeleton
    rotations: Float32[np.ndarray, "frames joints 4"]
    root: Float64[np.ndarray, "frames 3"]
    placed_joints: tuple[int, ...]
    places: Float64[np.ndarray, "frames placed 3"]
    operations: tuple[str, ...]


def _decode(table: Float64[np.ndarray, "frames channels"], hierarchy: BvhHierarchy, name: str) -> _ChannelPose:
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
    places = np.repeat(offsets[None, [0, *placed]], len(table), axis=0)
    for place, index in enumerate((0, *placed)):
        for axis, column in joints[index].position_columns.items():
            places[:, place, axis] = table[:, column]
    rotations = np.empty((len(table), len(joints), 4), np.float32)
    for start in range(0, len(table), BLOCK_FRAMES):
        rotations[start : start + BLOCK_FRAMES] = local_rotations(table[start : start + BLOCK_FRAMES], hierarchy)
    return _fold_reference(_ChannelPose(skeleton, rotations, places[:, 0], placed, places[:, 1:], operations))


def local_rotations(
    table: Float64[np.ndarray, "frames channels"], hierarchy: BvhHierarchy
) -> Float32[np.ndarray, "frames joints 4"]:
    """The rotations of all joints, as the file has them, from the channels of some frames."""
    # Component-major in memory, as forward kinematics needs it. Joints with the same order of axes are batched.
    components = np.zeros((4, len(hierarchy.joints), len(table)), np.float32)
    components[0] = 1.0
    for order, members in hierarchy.joints_by_order().items():
        columns = [hierarchy.joints[index].rotation_columns[axis] for axis in range(len(order)) for index in members]
        degrees = np.ascontiguousarray(table.take(columns, axis=1).T)
        angles = np.radians(degrees).astype(np.float32).reshape(len(order), len(members), len(table))
        components[:, members] = kinematics.euler_to_quaternion(np.moveaxis(angles, 0, -1), order).transpose(2, 0, 1)
    return components.transpose(2, 1, 0)


def _positions(
    pose: _ChannelPose,
    root: Float32[np.ndarray, "frames 3"],
    skeleton: Skeleton,
    moving: tuple[int, ...],
    unit_metres: float,
) -> Float32[np.ndarray, "frames joints 3"]:
    """Joint positions in metres along the file's axes."""
    positions = np.empty((len(root), skeleton.num_joints, 3), np.float32)
    columns = [pose.placed_joints.index(joint) for joint in moving]
    for start in range(0, len(root), BLOCK_FRAMES):
        block = slice(start, start + BLOCK_FRAMES)
        offsets = None
        if moving:
            offsets = np.repeat(skeleton.offsets[None], len(root[block]), axis=0)
            offsets[:, list(moving)] = pose.places[block, columns] * unit_metres
        positions[block] = kinematics.forward_kinematics(pose.rotations[block], root[block], skeleton, offsets)
    return positions


def _starts_with_t_pose(table: Float64[np.ndarray, "frames channels"], hierarchy: BvhHierarchy) -> bool:
    """Whether frame 0 is the T-pose that B. Hahne's conversions of the CMU database begin with.

    The rule: in frame 0 the root has no rotation and every angle is a whole number of degrees, in frame 1 neither
    holds, and the root's position is the same in both. Captured poses do not satisfy it.
    """
    root = hierarchy.joints[0]
    places = list(root.position_columns.values())
    if len(table) < 2 or not places or len(root.rotation_columns) != 3 or len(hierarchy.joints) < 15:
        return False
    first, second = table[0], table[1]
    if first[root.rotation_columns].any() or not second[root.rotation_columns].any():
        return False
    angles = [column for joint in hierarchy.joints for column in joint.rotation_columns]
    whole = table[:2, angles] == np.round(table[:2, angles])
    return bool(whole[0].all() and not whole[1].all() and np.array_equal(first[places], second[places]))


def _fold_reference(pose: _ChannelPose) -> _ChannelPose:
    """Remove a root that only carries one moving joint, which becomes the root (Bandai-Namco's `joint_Root`)."""
    skeleton = pose.skeleton
    if (
        1 not in pose.placed_joints
        or skeleton.children(0) != (1,)
        or any(joint == 0 for joint, _ in skeleton.end_sites)
    ):
        return pose
    turn = pose.rotations[:, 0].astype(np.float64)
    rotations = np.ascontiguousarray(pose.rotations[:, 1:])
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
    return _ChannelPose(
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


def _first_skeleton(pose: _ChannelPose) -> Skeleton:
    """The skeleton with its bones in the first frame: position channels override an OFFSET."""
    offsets, joints, places = pose.skeleton.offsets.copy(), list(pose.placed_joints), pose.places[0]
    offsets[joints] = np.where(_leave_offset(places, places, offsets[joints])[:, None], offsets[joints], places)
    return replace(pose.skeleton, offsets=offsets)


def _leave_offset(
    lowest: Float64[np.ndarray, "placed 3"],
    highest: Float64[np.ndarray, "placed 3"],
    offsets: Float[np.ndarray, "placed 3"],
) -> Bool[np.ndarray, "placed"]:
    """Whether position channels are 0 up to rounding but the OFFSET is not (MakeHuman): the OFFSET then applies."""
    farthest = np.maximum(np.abs(lowest), np.abs(highest)).max(axis=1, initial=0.0)
    return np.asarray(farthest < NO_BONE * np.linalg.norm(offsets, axis=1))


def _settle_offsets(pose: _ChannelPose, tolerance: float) -> tuple[Skeleton, tuple[int, ...]]:
    """The bones of all frames, in file units, and the joints that move relative to their parents.

    Position channels that stay within `tolerance` file units are a constant offset. A constant that agrees with the
    file's OFFSET, or is 0 where that is not, leaves the OFFSET unchanged, so that takes share their skeleton.
    """
    offsets, moving = pose.skeleton.offsets.copy(), []
    lowest, highest = pose.places.min(axis=0), pose.places.max(axis=0)
    joints = np.array(pose.placed_joints, int)
    far = np.maximum(offsets[joints] - lowest, highest - offsets[joints]).max(axis=1, initial=0.0) > tolerance
    for place in np.flatnonzero(far & ~_leave_offset(lowest, highest, offsets[joints])).tolist():
        middle = np.median(pose.places[:, place], axis=0)
        offsets[joints[place]] = middle
        if max((middle - lowest[place]).max(), (highest[place] - middle).max()) > tolerance:
            moving.append(pose.placed_joints[place])
    return replace(pose.skeleton, offsets=offsets), tuple(moving)


def unique_names(names: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names made unique by _2, _3 …, and a log line if any was changed."""
    used: set[str] = set()
    unique: list[str] = []
    for name in names:
        candidate, number = name, 2
        while candidate in used:
            candidate, number = f"{name}_{number}", number + 1
        used.add(candidate)
        unique.append(candidate)
    changed = [new for old, new in zip(names, unique, strict=True) if old != new]
    return tuple(unique), (f"repeated joint names made unique: {', '.join(changed)}",) if changed else ()


def _write(motion: Motion, path: Path) -> None:
    from motionkit.io.bvh_writing import write_bvh

    write_bvh(motion, path)


FORMAT = Format(
    name="bvh",
    read=of_path(read_bvh),
    document=read_document,
    suffixes=(".bvh",),
    begins=b"HIERARCHY",
    write=_write,
    turns_up=True,
)
