"""AMC motions over ASF skeletons (Acclaim), as the CMU motion capture database publishes them.

An ASF file has bones with a rest direction, a length, an axis frame C and degrees of freedom; an AMC file has their
angles. A bone's local rotation is L = C·R(dof)·C⁻¹, its global one parent·L, its end start + global·(direction·length).
Joints are at the starts of bones (`AsfSkeleton`), so L is the joint's local rotation. AMC does not state a framerate.
Sources: http://research.cs.wisc.edu/graphics/Courses/cs-838-1999/Jeff/ASF-AMC.html, http://mocap.cs.cmu.edu.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32, Float64
from motionkit.core.skeleton import MAX_JOINTS, Skeleton
from motionkit.io import source_file
from motionkit.io.registry import ReadOptions
from motionkit.io.source_file import INLINE_BYTES, find_words, parse_number, to_numbers

ROTATIONS = {"rx": "X", "ry": "Y", "rz": "Z"}
ROOT_CHANNELS: tuple[str, ...] = ("tx", "ty", "tz", "rx", "ry", "rz")
INCH = 0.0254

# A line's number and its words; and the lines of a block by their first words, which are not among the words.
Line = tuple[int, list[str]]
Block = Mapping[str, Line]
Vector = Float64[np.ndarray, "3"]


@dataclass(frozen=True)
class AsfBone:
    """One bone, or the root (its `dof` is the channel order): its end relative to its start in file units, and C."""

    name: str
    end: Vector
    axis_frame: Float64[np.ndarray, "4"]
    dof: tuple[str, ...]


@dataclass(frozen=True)
class AsfSkeleton:
    """The root and all bones, parents first. The root position is in file units.

    `skeleton` has a joint at the start of every bone, with the bone's name: lfemur is the hip. Its offsets are in
    metres, and a leaf bone's end is an End Site.
    """

    bones: tuple[AsfBone, ...]
    skeleton: Skeleton
    unit_metres: float
    root_position: Vector


# Channel values in the order of the bones, and these: name, number of channels.
AmcTable = tuple[Float64[np.ndarray, "frames channels"], tuple[tuple[str, int], ...]]


def read_asfamc(path: Path, options: ReadOptions = ReadOptions()) -> Motion:
    """Read one AMC file and the ASF skeleton beside it: positions in metres, y up, true local rotations.

    The skeleton is SUBJECT.asf for SUBJECT_TAKE.amc, or the folder's only ASF file. Raises
    `FormatError`, with the reason `no-framerate` without `options.fps`, since AMC does not state a framerate.
    """
    data = source_file.read_bytes(path)
    if options.fps is None:
        message = "AMC states no framerate; give it with --fps (CMU: 120, some takes 60) or in an annotation CSV's fps"
        raise FormatError(message, path=path, reason="no-framerate")
    skeleton_path = find_skeleton(path)
    asf = _parsed_asf(source_file.read_bytes(skeleton_path), skeleton_path, options.unit_metres)
    table = parse_amc(data, path)
    rotations, root = _local_rotations(table, asf, path)
    origin = "given" if options.unit_metres else "ASF length unit"
    log = [f"lengths × {asf.unit_metres:.6g} to metres ({origin})"]
    rotations = np.ascontiguousarray(rotations)
    return source_file.motion_of(path, data, "asfamc", asf.skeleton, options.fps, log, rotations=rotations, root=root)


def find_skeleton(path: Path) -> Path:
    """The ASF file of an AMC file; raises `FormatError` (`no-skeleton`, `two-skeletons`)."""
    skeletons = sorted(entry for entry in path.parent.iterdir() if entry.suffix.lower() == ".asf")
    subject = path.stem.rsplit("_", 1)[0]
    named = [entry for entry in skeletons if entry.stem.lower() in (path.stem.lower(), subject.lower())]
    for candidates in (named, skeletons):
        if len(candidates) == 1:
            return candidates[0]
    if not skeletons:
        raise FormatError("no ASF skeleton in its folder, expected one", path=path, reason="no-skeleton")
    names = ", ".join(entry.name for entry in skeletons)
    message = f"its folder holds {len(skeletons)} skeletons ({names}), expected one or {subject}.asf"
    raise FormatError(message, path=path, reason="two-skeletons")


@lru_cache(maxsize=8)  # all takes of a subject share one file
def _parsed_asf(data: bytes, path: Path, unit_metres: float | None) -> AsfSkeleton:
    """A skeleton in metres, of 0.0254 / length unit each unless given; raises `FormatError` naming the line."""
    if not re.search(rb"(?m)^[ \t]*:(bonedata|root)\b", data):
        message = f"looks like {source_file.describe_content(data)}, expected an ASF skeleton"
        raise FormatError(message, path=path, reason="not-what-it-says")
    sections: dict[str, list[Line]] = {}
    section: list[Line] = []
    for number, text in enumerate(source_file.decode(data, path).splitlines(), start=1):
        words = text.split("#", 1)[0].split()
        if words and words[0].startswith(":"):
            section = sections.setdefault(words[0][1:].lower(), [])
        elif words:
            section.append((number, words))
    units, root_lines = (_block(sections.get(name, [])) for name in ("units", "root"))
    length_unit = _numbers(units, "length", 1, path)[0] if "length" in units else 1.0
    line, angle = units.get("angle", (None, ["deg"]))
    if not length_unit > 0 or angle != ["deg"]:
        message = f"length unit {length_unit} and angle {' '.join(angle)!r}, expected a positive number, and deg"
        raise _fault(message, path, line)
    line, order = root_lines.get("order", (None, list(ROOT_CHANNELS)))
    dof = tuple(word.lower() for word in order)
    if len(set(dof)) != len(dof) or not set(dof) <= set(ROOT_CHANNELS):
        raise _fault(f"root order {' '.join(dof)!r}, expected TX TY TZ RX RY RZ in some order", path, line)
    axis_line, axis = root_lines.get("axis", (0, []))
    frame = _axis_frame(_numbers(root_lines, "orientation", 3, path), (axis_line, axis), path)
    root, root_position = AsfBone("root", np.zeros(3), frame, dof), np.array(_numbers(root_lines, "position", 3, path))
    bones = _bones(sections.get("bonedata", []), path)
    parents = _parents(sections.get("hierarchy", []), bones, path)
    ordered = list(_depth_first(parents))
    lost = sorted(set(bones) - set(ordered))
    if lost:
        raise _fault(f"bones not connected to the root in :hierarchy: {', '.join(lost)}"[:400], path)
    metres = unit_metres or INCH / length_unit
    every = (root, *(bones[name] for name in ordered[1:]))
    skeleton = _skeleton(path.stem, every, parents, metres)
    return AsfSkeleton(every, skeleton, metres, root_position)


def _fault(message: str, path: Path, line: int | None = None) -> FormatError:
    return FormatError(message, path=path, reason="asf", line=line)


def _block(lines: list[Line]) -> Block:
    return {words[0].lower(): (line, words[1:]) for line, words in lines}


def _numbers(block: Block, keyword: str, count: int, path: Path) -> list[float]:
    """The first numbers of a keyword's line; zeros without such a line."""
    line, words = block.get(keyword, (0, ["0"] * count))
    if len(words) < count:
        raise _fault(f"{keyword} with {len(words)} numbers, expected {count}", path, line)
    return [parse_number(word, path, line) for word in words[:count]]


def _axis_frame(degrees: list[float], axis: Line, path: Path) -> Float64[np.ndarray, "4"]:
    """C as a quaternion: the angles are about fixed axes, in the order that the line of axes lists."""
    line, words = axis
    order = "".join(words).upper() or "XYZ"
    if sorted(order) != ["X", "Y", "Z"]:
        raise _fault(f"axis order {order!r}, expected a permutation of XYZ", path, line)
    return kinematics.euler_to_quaternion(np.array(degrees) * (np.pi / 180.0), order, kind="extrinsic")


def _bones(lines: list[Line], path: Path) -> dict[str, AsfBone]:
    """The bones of all begin … end blocks by name."""
    bones: dict[str, AsfBone] = {}
    block: list[Line] | None = None
    for line, words in lines:
        keyword = words[0].lower()
        if keyword == "begin":
            block = []
        elif block is None:
            raise _fault(f"{words[0]!r} outside begin … end", path, line)
        elif keyword == "end":
            bone = _bone(_block(block), path)
            if not bone.name or bone.name in bones or bone.name == "root":
                raise _fault(f"bone name {bone.name!r} is missing or repeated", path, line)
            if len(bones) >= MAX_JOINTS - 1:
                raise _fault(f"more than {MAX_JOINTS:,} bones", path, line)
            bones[bone.name], block = bone, None
        else:
            block.append((line, words))
    if block is not None or not bones:
        last_line = lines[-1][0] if lines else None
        raise _fault("the bone data ends early, expected begin … end blocks", path, last_line)
    return bones


def _bone(block: Block, path: Path) -> AsfBone:
    line, dof = block.get("dof", (0, []))
    unknown = [word.lower() for word in dof if word.lower() not in ROTATIONS]
    if unknown:
        raise _fault(f"degrees of freedom {', '.join(unknown)}, expected rx, ry, rz", path, line)
    direction = np.array(_numbers(block, "direction", 3, path))
    norm = float(np.linalg.norm(direction))
    axis_line, axis = block.get("axis", (0, []))
    return AsfBone(
        name=" ".join(block.get("name", (0, []))[1]),
        end=(direction / norm if norm > 0 else direction) * _numbers(block, "length", 1, path)[0],
        axis_frame=_axis_frame(_numbers(block, "axis", 3, path), (axis_line, axis[3:]), path),
        dof=tuple(word.lower() for word in dof),
    )


def _parents(lines: list[Line], bones: Mapping[str, AsfBone], path: Path) -> dict[str, str]:
    """The parent of each bone, in the order of the bones: a line has a parent and its children."""
    parents: dict[str, str] = {}
    for line, (parent, *children) in lines:
        if parent in ("begin", "end"):
            continue
        for child in children:
            if child in parents or child not in bones:
                raise _fault(f"bone {child!r} is unknown or has two parents", path, line)
            parents[child] = parent
    return {name: parents[name] for name in bones if name in parents}


def _depth_first(parents: Mapping[str, str], name: str = "root") -> Iterator[str]:
    """A bone, by default the root, and all below it, parents first."""
    yield name
    for child in (child for child, parent in parents.items() if parent == name):
        yield from _depth_first(parents, child)


def _skeleton(name: str, bones: tuple[AsfBone, ...], parents: Mapping[str, str], metres: float) -> Skeleton:
    places = {bone.name: place for place, bone in enumerate(bones)}
    indices = [places[parents[bone.name]] if bone.name in parents else -1 for bone in bones]
    ends = np.stack([bone.end * metres for bone in bones])
    offsets = np.stack([ends[parent] if parent >= 0 else np.zeros(3) for parent in indices])
    tips = [(joint, end.tolist()) for joint, end in enumerate(ends) if joint not in indices and end.any()]
    return Skeleton(
        name=name,
        joint_names=tuple(places),
        parents=tuple(indices),
        offsets=offsets.astype(np.float32),
        end_sites=tuple((joint, (x, y, z)) for joint, (x, y, z) in tips),
    )


def parse_amc(data: bytes, path: Path) -> AmcTable:
    """The channel values of all frames; raises `FormatError` naming the line and the frame.

    Files whose frames all have the lines of the first one, as those written by programs do, are read as a table.
    """
    start = re.search(rb"(?m)^[ \t]*\d+[ \t]*\r?$", data)
    head = data[: start.start()].upper() if start else b""
    if start is None or b":FULLY-SPECIFIED" not in head:
        message = f"looks like {source_file.describe_content(data)}, expected an AMC file with :FULLY-SPECIFIED"
        raise FormatError(message, path=path, reason="not-what-it-says")
    if b":RADIANS" in head:
        raise FormatError("angles in radians, expected :DEGREES", path=path, reason="radians")
    body = data[start.start() :].strip()
    second = re.search(rb"\n[ \t]*\d+[ \t\r]*\n", body)
    first = body if second is None else body[: second.start()]
    words = [line.split() for line in first.splitlines()[1:] if line.strip()]
    if not words:
        line = data[: start.start()].count(b"\n") + 1
        raise FormatError("the first frame has no bones", path=path, reason="truncated", line=line, frame=0)
    bones = tuple((name.decode("utf-8", "replace"), len(numbers)) for name, *numbers in words)
    values = _parse_regular(body, first)
    if values is None:
        return _parse_lines(data, bones, path)
    return np.ascontiguousarray(values[:, 1:]), bones


def _parse_regular(body: bytes, first: bytes) -> Float64[np.ndarray, "frames values"] | None:
    """Frame numbers and channel values; None if a frame has other words than names where the first one has names."""
    pattern, words = find_words(first), find_words(body)
    is_name = np.array([place == 0 for line in first.splitlines() for place, _ in enumerate(line.split())])
    if len(is_name) != len(pattern.lengths):  # control characters end words here, and not there
        return None
    is_name[0] = False  # the frame's number
    longest = int(pattern.lengths[is_name].max())
    if len(words.starts) % len(is_name) or longest > INLINE_BYTES:
        return None
    starts, lengths = (each.reshape(-1, len(is_name)) for each in (words.starts, words.lengths))
    letters, expected = (
        each.windows(INLINE_BYTES)[places.ravel()].view(np.uint8).reshape(len(places), -1, INLINE_BYTES)
        for each, places in ((words, starts[:, is_name]), (pattern, pattern.starts[None, is_name]))
    )
    beyond = np.arange(INLINE_BYTES) >= pattern.lengths[is_name, None]
    if (lengths[:, is_name] != pattern.lengths[is_name]).any() or not ((letters == expected) | beyond).all():
        return None
    numbers = to_numbers(words._replace(starts=starts[:, ~is_name].ravel(), lengths=lengths[:, ~is_name].ravel()))
    values = None if numbers is None else numbers.reshape(len(starts), -1)
    return None if values is None or (np.diff(values[:, 0]) != 1).any() or values[0, 0] % 1 else values


def _parse_lines(data: bytes, bones: tuple[tuple[str, int], ...], path: Path) -> AmcTable:
    """The same line by line; raises `FormatError` at the first line that is not as in the first frame."""
    if len(dict(bones)) != len(bones):
        raise FormatError("a bone is listed twice in the first frame", path=path, reason="bones")
    rows: list[list[float]] = []
    numbers: list[int] = []

    def fault(message: str, reason: str) -> FormatError:
        return FormatError(message, path=path, reason=reason, line=line, frame=max(len(rows) - 1, 0))

    place, line = -1, 0  # in the frame: its number, then its bones
    for line, text in enumerate(data.splitlines(), start=1):
        words = text.split()
        if not words or words[0][:1] in (b"#", b":"):
            continue
        place = (place + 1) % (1 + len(bones))
        first = words[0].decode("utf-8", "replace")
        name, count = bones[place - 1] if place else ("a frame number", 0)
        if first != name and (place or not first.isdecimal()):
            raise fault(f"{first[:40]!r}, expected {name}, as in the first frame", "bones")
        if len(words) - 1 != count:
            raise fault(f"{len(words) - 1} numbers for {name}, expected {count}", "channel-count")
        if place:
            rows[-1] += [parse_number(word, path, line, len(rows) - 1) for word in words[1:]]
            continue
        rows.append([])
        numbers.append(int(first[:15]))
        if len(numbers) > 1 and numbers[-1] != numbers[-2] + 1:
            raise fault(f"frame number {first[:15]} after {numbers[-2]}, expected {numbers[-2] + 1}", "frame-number")
    if place != len(bones):
        raise fault(f"the frame ends without {bones[place][0]}; expected {len(bones)} bones", "truncated")
    return np.array(rows, dtype=np.float64), bones


def _local_rotations(
    table: AmcTable, asf: AsfSkeleton, path: Path
) -> tuple[Float32[np.ndarray, "frames joints 4"], Float32[np.ndarray, "frames 3"]]:
    channels, bones = table
    num_frames = len(channels)
    names = [bone.name for bone in asf.bones]
    rotations = np.zeros((num_frames, len(names), 4), np.float32)
    rotations[..., 0] = 1.0
    root = np.repeat(asf.root_position[None], num_frames, axis=0)
    column = 0
    for name, count in bones:
        if name not in names:
            raise FormatError(f"bone {name!r} is not in the skeleton", path=path, reason="bones")
        joint = names.index(name)
        bone = asf.bones[joint]
        if len(bone.dof) != count:
            message = f"{count} numbers for {name}, but the skeleton gives it {len(bone.dof)} ({' '.join(bone.dof)})"
            raise FormatError(message, path=path, reason="channel-count", frame=0)
        values = channels[:, column : column + count]
        column += count
        turning = [place for place, dof in enumerate(bone.dof) if dof in ROTATIONS]
        for place, dof in enumerate(bone.dof):
            if dof not in ROTATIONS:
                root[:, "xyz".index(dof[1])] += values[:, place]
        if turning:
            angles = values[:, turning] * (np.pi / 180.0)
            order = "".join(ROTATIONS[bone.dof[place]] for place in turning)
            turn = kinematics.euler_to_quaternion(angles, order, kind="extrinsic")
            back = kinematics.quaternion_conjugate(bone.axis_frame)
            turn = kinematics.quaternion_multiply(bone.axis_frame, turn)
            rotations[:, joint] = kinematics.quaternion_multiply(turn, back)
    return rotations, (root * asf.unit_metres).astype(np.float32)
