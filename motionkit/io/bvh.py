"""BVH (BioVision Hierarchy): a text file of joints with offsets and channels, then one line of numbers per frame.

Channels are degrees and file units; a joint's rotation is the product of its rotation channels in the order in which
they are listed; position channels replace the joint's OFFSET. Source: M. Meredith and S. Maddock, "Motion Capture File
Formats Explained", University of Sheffield CS-01-11, 2001.
"""

import re
from collections.abc import Iterable
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
from motionkit.core.skeletons.mapping import SkeletonMapError, body_axis, rest_positions, rig_name, with_layout_map
from motionkit.core.timegrid import TimeGrid, parse_fps
from motionkit.io import body_frame, source_file
from motionkit.io.body_frame import from_y_up, infer_up, log_lines, skeleton_to_y_up, to_y_up, turn_of
from motionkit.io.registry import ReadOptions

if TYPE_CHECKING:
    from motionkit.fields.motion_field import Poses

CHANNELS = {f"{axis}{kind}": (axis, kind) for axis in "XYZ" for kind in ("position", "rotation")}
# Smaller changes of a bone are noise of printed digits; a bone with larger ones is not rigid.
RIGID_METRES = 1e-3
T_POSE_DROPPED = "frame 0 dropped: a T-pose (root unturned, all angles whole degrees, root where frame 1 is)"
# Bones are longer than this, relative to their OFFSET.
NO_BONE = 1e-3
WRITTEN_DECIMALS = 6
# Tolerance of written positions against the expected ones, and of rotations, which are float32.
_SAME_METRES = 2e-6
_SAME_RADIANS = 2e-6
_MOTION = re.compile(rb"(?m)^[ \t]*MOTION[ \t]*\r?$")
_FRAMES = re.compile(rb"(?i)\s*Frames[ \t]*:[ \t]*(\d{1,11})[ \t\r]*\n")
_FRAME_TIME = re.compile(rb"(?i)\s*Frame[ \t]+Time[ \t]*:([^\n]*)")
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
class BvhHead:
    """The lines before the numbers, which follow `frame_time_line`: `text` ends with the word MOTION.

    `joints` are in file order, parents first; a frame has `num_channels` numbers.
    """

    text: bytes
    joints: tuple[BvhJoint, ...]
    num_frames: int
    frame_time: str
    frame_time_line: int

    @property
    def num_channels(self) -> int:
        """The number of channels of one frame."""
        return sum(len(joint.position_columns) + len(joint.rotation_columns) for joint in self.joints)


@dataclass(frozen=True, eq=False)
class BvhDocument:
    """A BVH file in memory: its motion, and the text and numbers from which it can be written again.

    Frame k of the motion is `lines[k]` of the file as written, and row k of `table` (file units and degrees). `body` is
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
        )


def read_bvh(path: Path, options: ReadOptions = ReadOptions()) -> Motion:
    """Read one BVH file: positions in metres, y up, true local rotations, at the stated framerate.

    The unit is `options.unit_metres` or inferred (`body_frame.infer_unit`); a T-pose in frame 0, as B. Hahne's
    conversions of the CMU database have it, is dropped; a motion that is not y up is turned (`body_frame.infer_up`).
    All of this is in the operation log. Raises `FormatError` with a reason, the line and the frame.
    """
    return read_document(path, options, strict=True).motion


def read_document(path: Path, options: ReadOptions = ReadOptions(), *, strict: bool = False) -> BvhDocument:
    """Read one BVH file to be written again; with `strict`, raises `FormatError` whenever `read_bvh` does.

    Otherwise a skeleton that is not a human body in any unit is accepted.
    """
    data = source_file.read_bytes(path)
    # Lines of old Macintoshes end in a carriage return alone.
    head, body = split_text(data if b"\n" in data else data.replace(b"\r", b"\n"), path)
    provenance = source_file.provenance(path, data, "bvh", (), stated_fps=f"Frame Time: {head.frame_time}")
    del data  # before the memory of the numbers is needed
    num_channels = head.num_channels
    fps, operations = source_file.fps_in_use(options.fps, lambda: _stated_fps(head, path))
    # A number takes at least a digit and a separator: a shorter text is truncated, which its last line says.
    if 2 * head.num_frames * num_channels - 1 <= len(body):
        source_file.check_size(head.num_frames, len(head.joints), path)
    table = source_file.read_table(body, head.num_frames, num_channels, path, head.frame_time_line + 1)
    has_reference = _starts_with_t_pose(table, head.joints)
    if has_reference:
        table = table[1:]
        operations.append(T_POSE_DROPPED)
    pose = _decode(table, head.joints)
    pose = replace(pose, skeleton=with_layout_map(pose.skeleton, options.skeleton_maps))
    unit_metres, reason = _unit(pose, options, path, strict)
    skeleton, moving = _settle_offsets(pose, RIGID_METRES / unit_metres)
    operations += [*pose.operations, f"lengths × {unit_metres:.6g} to metres ({reason})"]
    if moving:
        names = ", ".join(skeleton.joint_names[joint] for joint in moving)
        operations.append(f"positions only: these bones change their length or place ({names})")
    skeleton = skeleton.scaled(unit_metres)
    root = (pose.root * unit_metres).astype(np.float32)
    offsets = None  # of every frame
    if moving:
        columns = [pose.placed_joints.index(joint) for joint in moving]
        offsets = np.repeat(skeleton.offsets[None], len(root), axis=0)
        offsets[:, list(moving)] = pose.places[:, columns] * unit_metres
    positions = kinematics.forward_kinematics(pose.rotations, root, skeleton, offsets)
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
        unit_metres=unit_metres,
        moving=moving,
        up=up,
        rest_has_same_up=rest_has_same_up,
    )


def _lines(body: bytes) -> list[bytes]:
    return [stripped for line in body.split(b"\n") if (stripped := line.strip(_BLANK))]


def _unit(pose: "_ChannelPose", options: ReadOptions, path: Path, strict: bool) -> tuple[float, str]:
    if options.unit_metres is not None:
        return options.unit_metres, "given"
    unit = body_frame.infer_unit(_first_skeleton(pose))
    if unit is not None:
        return unit
    if not strict:
        return 1.0, "in no unit the size of a human body"
    message = "no usual unit gives this skeleton the size of a human body; say how long a unit is with --unit-metres"
    raise FormatError(message, path=path, reason="unit")


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
        message = f"looks like {source_file.describe_content(data)}, expected a BVH file that begins with HIERARCHY"
        raise FormatError(message, path=path, reason="not-what-it-says", line=1)
    motion = _MOTION.search(data)
    try:
        joints = parse_hierarchy(source_file.decode(data[: motion.start() if motion else len(data)], path))
    except FormatError as error:
        raise FormatError(error.message, path=path, reason=error.reason, line=error.line) from None
    if motion is None:
        message = f"the file ends after the hierarchy of {len(joints)} joints, expected MOTION"
        raise FormatError(message, path=path, reason="truncated", line=data.count(b"\n") + 1)
    counted = _FRAMES.match(data, motion.end())
    timed = _FRAME_TIME.match(data, counted.end()) if counted else None
    if counted is None or timed is None:
        rest = data[(counted or motion).end() :].lstrip()
        line = data.count(b"\n", 0, len(data) - len(rest)) + 1
        expected, reason = ("Frame Time: seconds", "frame-time") if counted else ("Frames: count", "frame-count")
        raise FormatError(f"expected '{expected}'", path=path, reason=reason if rest else "truncated", line=line)
    if int(counted[1]) == 0:
        line = data.count(b"\n", 0, counted.start(1)) + 1
        raise FormatError("0 frames, expected at least one", path=path, reason="no-frames", line=line)
    frame_time, time_line = timed[1].decode("utf-8", "replace").strip(), data.count(b"\n", 0, timed.start(1)) + 1
    head = BvhHead(data[: motion.end()], joints, int(counted[1]), frame_time, time_line)
    if not head.num_channels:
        raise FormatError("no joint has CHANNELS, so nothing moves", path=path, reason="channels")
    return head, data[timed.end() + 1 :].rstrip()


def _stated_fps(head: BvhHead, path: Path) -> Fraction:
    try:
        return parse_fps(1.0 / float(head.frame_time))
    except (ValueError, ZeroDivisionError, OverflowError) as error:
        message = f"'Frame Time: {head.frame_time[:40]}' is no usable time in seconds ({error}); give the framerate"
        raise FormatError(message, path=path, reason="frame-time", line=head.frame_time_line) from None


@lru_cache(maxsize=64)  # the takes of a corpus have identical hierarchies
def parse_hierarchy(text: str) -> tuple[BvhJoint, ...]:
    """The joints in the lines from HIERARCHY up to MOTION.

    Raises `FormatError` (`hierarchy`, `channels`) without a path, naming the line.
    """
    joints: list[BvhJoint] = []
    opened: list[int] = []  # joints whose braces are open; −1 stands for an End Site
    pending: list[int] = []  # what the next "{" opens
    num_channels, line = 0, 0

    def fault(message: str, reason: str = "hierarchy") -> FormatError:
        return FormatError(message, path="", reason=reason, line=line)

    for line, content in enumerate(text.splitlines(), start=1):
        for statement in filter(None, map(str.strip, re.split(r"([{}])", content))):
            keyword, *words = statement.split()
            inner = joints[opened[-1]] if opened and opened[-1] >= 0 and not pending else None
            match keyword.upper():
                case "HIERARCHY" if not joints:
                    continue
                case "ROOT" if joints:
                    raise fault(f"a second {statement!r}: one skeleton to a file is expected")
                case "JOINT" if inner is None:
                    raise fault(f"{statement!r} is not inside the ROOT")
                case "ROOT" | "JOINT":  # a name may hold spaces and colons
                    name = statement[len(keyword) :].strip() or f"joint{len(joints)}"
                    joints.append(BvhJoint(name, opened[-1] if opened else -1))
                    pending.append(len(joints) - 1)
                    if len(joints) > MAX_JOINTS:
                        raise fault(f"more than {MAX_JOINTS} joints")
                case "END" if inner is not None:
                    pending.append(-1)
                case "{" if pending:
                    opened.append(pending.pop())
                case "}" if opened and not pending:
                    opened.pop()
                    if inner is not None and inner.offset is None:
                        raise fault(f"joint {inner.name!r} has no OFFSET")
                case "OFFSET" if opened and not pending:
                    if len(words) != 3:
                        raise fault(f"OFFSET with {len(words)} numbers, expected 3")
                    x, y, z = (source_file.parse_number(word, Path(), line) for word in words)
                    if inner is not None:
                        inner.offset = (x, y, z)
                    else:
                        owner = joints[opened[-2]]
                        owner.end_site = owner.end_site or (x, y, z)
                case "CHANNELS" if inner is not None:
                    if not words or words[0] != str(len(words) - 1) or inner.order or inner.position_columns:
                        expected = f"expected a count and that many names, once for joint {inner.name!r}"
                        raise fault(f"{statement[:60]!r}: {expected}", "channels")
                    for column, word in enumerate(words[1:], start=num_channels):
                        axis, kind = CHANNELS.get(word.capitalize(), ("", ""))
                        if kind == "position" and "XYZ".index(axis) not in inner.position_columns:
                            inner.position_columns["XYZ".index(axis)] = column
                        elif kind == "rotation" and len(inner.order) < 3 and not inner.order.endswith(axis):
                            inner.rotation_columns.append(column)
                            inner.order += axis
                        else:
                            expected = f"each of {', '.join(CHANNELS)} at most once, no axis twice in a row"
                            raise fault(f"channel {word!r} of joint {inner.name!r}: expected {expected}", "channels")
                    num_channels += len(words) - 1
                case "END" | "{" | "}" | "OFFSET" | "CHANNELS":
                    raise fault(f"{statement[:40]!r} is out of place")
                case _:
                    raise fault(f"{statement[:40]!r}, expected ROOT, JOINT, End Site, OFFSET, CHANNELS, '{{' or '}}'")
    if not joints or opened or pending:
        raise fault("the hierarchy ends inside a joint, expected '}'" if joints else "no ROOT joint in the hierarchy")
    return tuple(joints)


@dataclass(frozen=True)
class _ChannelPose:
    """The decoded channels. `places` are the offsets that position channels give to `placed_joints` below the root."""

    skeleton: Skeleton
    rotations: Float32[np.ndarray, "frames joints 4"]
    root: Float64[np.ndarray, "frames 3"]
    placed_joints: tuple[int, ...]
    places: Float64[np.ndarray, "frames placed 3"]
    operations: tuple[str, ...]


def _decode(table: Float64[np.ndarray, "frames channels"], joints: tuple[BvhJoint, ...]) -> _ChannelPose:
    names, operations = source_file.unique_names([joint.name for joint in joints])
    offsets = np.array([joint.offset for joint in joints], dtype=np.float64)
    skeleton = Skeleton(
        name=rig_name(names),
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
    rotations = np.ascontiguousarray(local_rotations(table, joints))
    return _fold_reference(_ChannelPose(skeleton, rotations, places[:, 0], placed, places[:, 1:], operations))


def local_rotations(
    table: Float64[np.ndarray, "frames channels"], joints: tuple[BvhJoint, ...]
) -> Float32[np.ndarray, "frames joints 4"]:
    """The rotations of all joints, as the file has them, from the channels of some frames."""
    # Component-major in memory, as forward kinematics needs it. Joints with the same order of axes are batched.
    components = np.zeros((4, len(joints), len(table)), np.float32)
    components[0] = 1.0
    by_order: dict[str, list[int]] = {}
    for index, joint in enumerate(joints):
        if joint.order:
            by_order.setdefault(joint.order, []).append(index)
    for order, members in by_order.items():
        columns = [joints[index].rotation_columns[axis] for axis in range(len(order)) for index in members]
        degrees = np.ascontiguousarray(table.take(columns, axis=1).T)
        angles = np.radians(degrees).astype(np.float32).reshape(len(order), len(members), len(table))
        components[:, members] = kinematics.euler_to_quaternion(np.moveaxis(angles, 0, -1), order).transpose(2, 0, 1)
    return components.transpose(2, 1, 0)


def _starts_with_t_pose(table: Float64[np.ndarray, "frames channels"], joints: tuple[BvhJoint, ...]) -> bool:
    """Whether frame 0 is the T-pose that B. Hahne's conversions of the CMU database begin with.

    The rule: in frame 0 the root has no rotation and every angle is a whole number of degrees, in frame 1 neither
    holds, and the root's position is the same in both. Captured poses do not satisfy it.
    """
    root = joints[0]
    places = list(root.position_columns.values())
    if len(table) < 2 or not places or len(root.rotation_columns) != 3 or len(joints) < 15:
        return False
    first, second = table[0], table[1]
    if first[root.rotation_columns].any() or not second[root.rotation_columns].any():
        return False
    angles = [column for joint in joints for column in joint.rotation_columns]
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


def write_bvh(motion: Motion, path: Path, *, unit_metres: float = 0.01) -> None:
    """Write a motion with its skeleton: in centimetres unless `unit_metres` is given, ZXY rotations, six decimals.

    Reading it back gives the same framerate, the joints (depth first), and positions within 0.15 mm. A motion without
    rotations gets them by inverse kinematics on its own bones. If rigid bones miss no joint by more than 2 mm, only the
    root has position channels (and joints are within that distance); else every joint has them. The frame time is
    written with all its digits.
    """
    from motionkit.io.joint_rotations import joint_channels  # reading a file loads no motion fields

    animated = joint_channels(motion)
    skeleton, translations = animated.skeleton, animated.translations
    rotations = animated.rotations.astype(np.float64)
    angles = np.degrees(_euler_angles(rotations.reshape(-1, 4), "ZXY")).reshape(*rotations.shape[:2], 3)
    scale = 1.0 / unit_metres
    order, lines = _hierarchy(skeleton, translations, scale)
    columns = []
    for joint in order:
        if joint in translations:
            columns.append(translations[joint].astype(np.float64) * scale)
        columns.append(angles[:, joint])
    table = np.round(np.concatenate(columns, axis=1), WRITTEN_DECIMALS) + 0.0
    lines += ["MOTION", f"Frames: {motion.num_frames}", f"Frame Time: {float(1 / motion.fps)!r}", ""]
    path.write_bytes("\n".join(lines).encode() + source_file.format_table(table))


def _euler_angles(rotations: Float64[np.ndarray, "rotations 4"], axes: str) -> Float64[np.ndarray, "rotations 3"]:
    """Angles in radians about the axes; in gimbal lock the last one is 0."""
    import warnings

    from scipy.spatial.transform import Rotation

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about gimbal lock
        return np.array(Rotation.from_quat(rotations, scalar_first=True).as_euler(axes))  # type: ignore[call-overload]


def _hierarchy(skeleton: Skeleton, translated: Iterable[int], scale: float) -> tuple[list[int], list[str]]:
    """The joints depth first, as a file lists them, and the lines of the hierarchy, in metres × `scale`."""
    order: list[int] = []
    lines = ["HIERARCHY"]
    tips = dict(skeleton.end_sites)

    def offset(vector: Iterable[float]) -> str:
        return "OFFSET " + " ".join(f"{value * scale:.6f}" for value in vector)

    waiting: list[tuple[int, str, bool]] = [(0, "", False)]  # joints to open, or to close, with their indentation
    while waiting:
        joint, indent, is_open = waiting.pop()
        children = skeleton.children(joint)
        if is_open:
            tip = tips.get(joint, None if children else (0.0, 0.0, 0.0))
            if tip is not None:
                lines += [f"{indent}\tEnd Site", f"{indent}\t{{", f"{indent}\t\t{offset(tip)}", f"{indent}\t}}"]
            lines.append(f"{indent}}}")
            continue
        places = "Xposition Yposition Zposition " if joint in translated else ""
        lines += [
            f"{indent}{'JOINT' if order else 'ROOT'} {skeleton.joint_names[joint]}",
            f"{indent}{{",
            f"{indent}\t{offset(skeleton.offsets[joint].tolist())}",
            f"{indent}\tCHANNELS {6 if places else 3} {places}Zrotation Xrotation Yrotation",
        ]
        order.append(joint)
        waiting += [(joint, indent, True), *((child, f"{indent}\t", False) for child in reversed(children))]
    return order, lines


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

    Kept rows are the document's lines, unchanged. The angles of the others are the nearest to those on straight lines
    between the known frames, and a channel that is constant between two of these keeps its exact digits.
    """
    from motionkit.fields.motion_field import Poses  # reading a file loads no motion fields

    rows = _channel_rows(document, Poses.of(motion), motion.timegrid.seconds(), known)
    lines = source_file.format_table(np.round(rows, WRITTEN_DECIMALS) + 0.0).splitlines()
    frame_time = document.head.frame_time if motion.fps == document.motion.fps else repr(float(1 / motion.fps))
    clock_lines = f"Frames: {len(lines) + document.has_reference}\nFrame Time: {frame_time}"
    before = [document.head.text.rstrip().replace(b"\r\n", b"\n"), clock_lines.encode()]
    before += [_lines(document.body)[0]] if document.has_reference else []
    for row, frame in zip(known.kept_rows.tolist(), known.kept_frames.tolist(), strict=True):
        lines[row] = document.lines[frame]
    path.write_bytes(b"\n".join((*before, *lines, b"")))


def _channel_rows(
    document: BvhDocument, poses: "Poses", seconds: Float64[np.ndarray, "times"], known: KnownFrames
) -> Float64[np.ndarray, "times channels"]:
    """Poses as rows of channels."""
    anchors = document.table[known.frames]
    expected = np.stack([np.interp(seconds, known.seconds, channel) for channel in anchors.T], axis=1)
    joints, skeleton = document.head.joints, document.motion.skeleton
    rotations, positions = _file_axes(document, poses)
    placed = (0, *document.moving)
    places = _places(rotations, positions, skeleton, placed)
    # If the file's root only carries the next joint, that one is the body's root.
    carried = len(joints) - skeleton.num_joints
    if carried:
        back = kinematics.quaternion_conjugate(local_rotations(expected, joints)[:, 0].astype(np.float64))
        rotations[:, 0] = kinematics.quaternion_multiply(back, rotations[:, 0])
        root = joints[0]
        carrier = np.repeat(np.array([root.offset], np.float64), len(expected), axis=0)
        carrier[:, list(root.position_columns)] = expected[:, list(root.position_columns.values())]
        places[:, 0] = kinematics.quaternion_rotate(back, places[:, 0] - carrier * document.unit_metres)
    rows = expected.copy()
    for place, body_joint in enumerate(placed):
        for axis, column in joints[body_joint + carried].position_columns.items():
            value = places[:, place, axis] / document.unit_metres
            close = np.abs(value - expected[:, column]) * document.unit_metres < _SAME_METRES
            rows[:, column] = np.where(close, expected[:, column], value)
    for index, joint in enumerate(joints):
        if joint.order and index >= carried:
            columns = joint.rotation_columns
            angles = angles_near(rotations[:, index - carried], joint.order, expected[:, columns])
            rows[:, columns] = angles if len(anchors) > 1 else np.unwrap(angles, period=360.0, axis=0)
    return rows


def _file_axes(
    document: BvhDocument, poses: "Poses"
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


def angles_near(
    rotations: Float64[np.ndarray, "times 4"], order: str, expected: Float64[np.ndarray, "times axes"]
) -> Float64[np.ndarray, "times axes"]:
    """Euler angles in degrees about the axes of `order` (one to three), the nearest to the `expected` ones.

    If these give the rotation, they are returned, so a constant channel keeps its exact digits. An order of fewer than
    three axes gives the angles of the nearest rotation about those axes.
    """
    axes = order + "".join(axis for axis in "XYZ" if axis not in order) if len(order) < 3 else order
    expected = np.radians(np.pad(expected, ((0, 0), (0, 3 - len(order)))))
    between = kinematics.quaternion_multiply(
        kinematics.quaternion_conjugate(kinematics.euler_to_quaternion(expected, axes)), rotations
    )
    same = 2 * np.arctan2(np.linalg.norm(between[:, 1:], axis=-1), np.abs(between[:, 0])) < _SAME_RADIANS
    # A rotation has two triples of angles, each up to full turns.
    first, second, third = (angles := _euler_angles(rotations, axes)).T
    second = -second if axes[0] == axes[2] else np.pi - second
    both = np.stack((angles, np.stack((first + np.pi, second, third + np.pi), axis=-1)))
    both += 2 * np.pi * np.rint((expected - both) / (2 * np.pi))
    nearest = np.abs(both - expected).sum(axis=-1).argmin(axis=0)
    return np.degrees(np.where(same[:, None], expected, both[nearest, np.arange(len(both[0]))]))[:, : len(order)]
