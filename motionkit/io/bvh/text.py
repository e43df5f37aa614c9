"""A BVH file as text: the head with its hierarchy, the clock, and the lines of numbers, all as written."""

import re
from dataclasses import dataclass, field
from fractions import Fraction
from functools import lru_cache
from pathlib import Path

from motionkit.core.errors import FormatError
from motionkit.core.framerate import parse_fps
from motionkit.core.plain_text import whole_number
from motionkit.core.skeleton import MAX_JOINTS
from motionkit.io.source import source_file
from motionkit.io.source.number_table import parse_number
from motionkit.io.source.source_file import PART_BYTES, FileParts

CHANNELS = {f"{axis}{kind}": (axis, kind) for axis in "XYZ" for kind in ("position", "rotation")}


@dataclass
class BvhJoint:
    """A joint as written: `position_columns` maps an axis 0…2 to its column, `rotation_columns` are in `order`."""

    name: str
    parent: int
    offset: tuple[float, float, float] | None = None
    has_channels: bool = False
    position_columns: dict[int, int] = field(default_factory=dict)
    rotation_columns: list[int] = field(default_factory=list)
    order: str = ""
    end_site: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class BvhHierarchy:
    """The joints in file order (parents first) and the number of channels of one frame."""

    joints: tuple[BvhJoint, ...]
    num_channels: int


def parse_hierarchy(text: str, path: Path) -> BvhHierarchy:
    """Read the lines from HIERARCHY up to MOTION; raises `FormatError` (`hierarchy`, `channels`) naming the line."""
    try:
        return parsed(text)
    except FormatError:
        # Failures are not cached; this raises the error for this file.
        return _Parser(path).parse(text)


@lru_cache(maxsize=64)
def parsed(text: str) -> BvhHierarchy:
    """A cached hierarchy: the takes of a corpus have identical ones."""
    return _Parser(Path()).parse(text)


class _Parser:
    def __init__(self, path: Path) -> None:
        self.path = path
        self.line = 0
        self.joints: list[BvhJoint] = []
        self.num_channels = 0
        self.open: list[int] = []  # joints whose braces are open; −1 stands for an End Site
        self.pending: int | None = None  # what the next "{" opens

    def parse(self, text: str) -> BvhHierarchy:
        """Feed all lines, then check for completeness."""
        for self.line, line in enumerate(text.splitlines(), start=1):
            self.feed(line.strip())
        if self.open or self.pending is not None:
            raise self.fault("the hierarchy ends inside a joint, expected '}'")
        if not self.joints:
            raise self.fault("no ROOT joint in the hierarchy")
        return BvhHierarchy(tuple(self.joints), self.num_channels)

    def fault(self, message: str, reason: str = "hierarchy") -> FormatError:
        """An error at the current line."""
        return FormatError(message, path=self.path, reason=reason, line=self.line)

    def feed(self, line: str) -> None:
        """Parse one line, which may contain braces."""
        for part in re.split(r"([{}])", line) if "{" in line or "}" in line else (line,):
            match part.strip():
                case "":
                    continue
                case "{":
                    self.open_brace()
                case "}":
                    self.close_brace()
                case statement:
                    self.statement(statement)

    def open_brace(self) -> None:
        """Enter the joint or End Site that was just named."""
        if self.pending is None:
            raise self.fault("'{' without a joint before it")
        self.open.append(self.pending)
        self.pending = None

    def close_brace(self) -> None:
        """Leave a joint or End Site, which must be complete by now."""
        if not self.open or self.pending is not None:
            raise self.fault("'}' without a '{' before it")
        joint = self.open.pop()
        if joint >= 0 and self.joints[joint].offset is None:
            raise self.fault(f"joint {self.joints[joint].name!r} has no OFFSET")

    def statement(self, line: str) -> None:
        """ROOT, JOINT, End Site, OFFSET or CHANNELS."""
        keyword, _, rest = line.replace("\t", " ").partition(" ")
        rest = rest.strip()
        match keyword.upper():
            case "HIERARCHY" if not self.joints:
                return
            case "ROOT" | "JOINT":
                self.begin_joint(keyword.upper(), rest)
            case "END":
                if not self.open or self.open[-1] < 0:
                    raise self.fault("an End Site outside a joint")
                self.pending = -1
            case "OFFSET":
                self.offset(rest.split())
            case "CHANNELS":
                self.channels(rest.split())
            case _:
                raise self.fault(f"{line[:40]!r}, expected ROOT, JOINT, End Site, OFFSET, CHANNELS, '{{' or '}}'")

    def begin_joint(self, keyword: str, name: str) -> None:
        """Start a joint; its name may hold spaces and colons."""
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
        """OFFSET of a joint or of an End Site."""
        if not self.open or self.pending is not None:
            raise self.fault("OFFSET outside a joint")
        if len(words) != 3:
            raise self.fault(f"OFFSET with {len(words)} numbers, expected 3")
        x, y, z = (parse_number(word, self.path, self.line) for word in words)
        if self.open[-1] >= 0:
            self.joints[self.open[-1]].offset = (x, y, z)
        else:
            owner = self.joints[self.open[-2]]
            if owner.end_site is None:
                owner.end_site = (x, y, z)

    def channels(self, words: list[str]) -> None:
        """CHANNELS n name…, in any order."""
        if not self.open or self.open[-1] < 0 or self.pending is not None:
            raise self.fault("CHANNELS outside a joint", "channels")
        joint = self.joints[self.open[-1]]
        if joint.has_channels:
            raise self.fault(f"joint {joint.name!r} has CHANNELS twice", "channels")
        joint.has_channels = True
        if not words or whole_number(words[0]) != len(words) - 1:
            raise self.fault(f"CHANNELS {' '.join(words)[:60]!r}: expected a count and that many names", "channels")
        for word in words[1:]:
            axis, kind = CHANNELS.get(word) or CHANNELS.get(word[:1].upper() + word[1:].lower(), ("", ""))
            if not axis or (kind == "position" and "XYZ".index(axis) in joint.position_columns):
                raise self.fault(f"channel {word!r}: expected each of {', '.join(CHANNELS)} at most once", "channels")
            if kind == "position":
                joint.position_columns["XYZ".index(axis)] = self.num_channels
            else:
                joint.rotation_columns.append(self.num_channels)
                joint.order += axis
            self.num_channels += 1
        if len(joint.order) > 3:
            raise self.fault(
                f"joint {joint.name!r} has {len(joint.order)} rotation channels, expected at most 3", "channels"
            )


LARGEST_HEAD = 64 << 20
_MOTION = re.compile(rb"(?m)^[ \t]*MOTION[ \t]*\r?$")


@dataclass(frozen=True)
class BvhText:
    """The text before the lines of numbers: `head` ends with the word MOTION; lines count from 1.

    The numbers begin with byte `body_start` of the file.
    """

    head: bytes
    hierarchy: BvhHierarchy
    num_frames: int
    frame_time: str
    frame_time_line: int
    body_start: int
    body_line: int


def read_head(file: FileParts) -> BvhText:
    """The text before the numbers of a file, read with little more; raises `FormatError` as `split_text` does.

    A hierarchy of more than 64 MiB is `too-large`.
    """
    length = PART_BYTES
    while True:
        data = file.read(0, min(length, file.size))
        if length >= file.size or holds_head(data):
            return split_text(data, file.path)
        if length > LARGEST_HEAD:
            message = f"no frames within the first {LARGEST_HEAD >> 20} MiB, expected a hierarchy and MOTION"
            raise FormatError(message, path=file.path, reason="too-large")
        length *= 4


def split_text(data: bytes, path: Path) -> BvhText:
    """Parse a file's beginning; raises `FormatError` naming the line of a missing part, or if it is not a BVH file."""
    # Lines of old Macintoshes end in a carriage return alone.
    data = data if b"\n" in data else data.replace(b"\r", b"\n")
    head = data[:4096].removeprefix(b"\xef\xbb\xbf").lstrip()
    if not head[:9].upper().startswith(b"HIERARCHY"):
        raise FormatError(
            f"looks like {source_file.describe_content(data)}, expected a BVH file that begins with HIERARCHY",
            path=path,
            reason="not-what-it-says",
            line=1,
        )
    motion = _MOTION.search(data)
    if motion is None:
        hierarchy = parse_hierarchy(source_file.decode(data, path), path)
        raise FormatError(
            f"the file ends after the hierarchy of {len(hierarchy.joints)} joints, expected MOTION",
            path=path,
            reason="truncated",
            line=data.count(b"\n") + 1,
        )
    hierarchy = parse_hierarchy(source_file.decode(data[: motion.start()], path), path)
    if not hierarchy.num_channels:
        raise FormatError("no joint has CHANNELS, so nothing moves", path=path, reason="channels")
    clock = _read_clock(data, motion.end(), path)
    body_line = clock.last_line + (clock.end <= len(data))
    return BvhText(
        head=data[: motion.end()],
        hierarchy=hierarchy,
        num_frames=_num_frames(clock.frames, path, body_line),
        frame_time=clock.frame_time,
        frame_time_line=clock.frame_time_line,
        body_start=clock.end,
        body_line=body_line,
    )


@dataclass
class _Clock:
    """The lines after MOTION, as written; `end` is the offset of the numbers, after `last_line`."""

    end: int
    last_line: int
    frames: str = ""
    frame_time: str = ""
    frame_time_line: int = 0


def _read_clock(data: bytes, start: int, path: Path) -> _Clock:
    clock = _Clock(start, data.count(b"\n", 0, start))
    while not (clock.frames and clock.frame_time):
        end = data.find(b"\n", clock.end)
        end = len(data) if end < 0 else end
        clock.last_line += 1
        words = source_file.decode(data[clock.end : end], path).strip()
        key, colon, value = words.partition(":")
        match " ".join(key.lower().split()) if colon else "":
            case "frames":
                clock.frames = value.strip()
            case "frame time":
                clock.frame_time, clock.frame_time_line = value.strip(), clock.last_line
            case _ if words:
                missing = "Frame Time: seconds" if clock.frames else "Frames: count"
                raise FormatError(
                    f"{words[:40]!r} where '{missing}' was expected",
                    path=path,
                    reason="frame-time" if clock.frames else "frame-count",
                    line=clock.last_line,
                )
        if end == len(data) and not (clock.frames and clock.frame_time):
            raise FormatError(
                "the file ends before its first frame, expected 'Frames:' and 'Frame Time:'",
                path=path,
                reason="truncated",
                line=clock.last_line,
            )
        clock.end = end + 1
    return clock


def holds_head(data: bytes) -> bool:
    """Whether the beginning of a file reaches its lines of numbers, or is not a BVH file."""
    start = data.removeprefix(b"\xef\xbb\xbf").lstrip()[:9].upper()
    if not b"HIERARCHY".startswith(start):
        return True
    motion = _MOTION.search(data)
    whole_lines = data[motion.end() :].split(b"\n")[1:-1] if motion else []
    return len([line for line in whole_lines if line.strip()]) >= 2


def _num_frames(stated: str, path: Path, body_line: int) -> int:
    if not (stated.isascii() and stated.isdecimal() and len(stated) < 12):
        raise FormatError(
            f"'Frames: {stated[:40]}', expected a whole number", path=path, reason="frame-count", line=body_line
        )
    if int(stated) == 0:
        raise FormatError("0 frames, expected at least one", path=path, reason="no-frames", line=body_line)
    return int(stated)


def stated_fps(file: BvhText, path: Path) -> Fraction:
    """The framerate of `Frame Time:`; raises `FormatError` (`frame-time`) naming the line."""
    try:
        return _fps_of(file.frame_time)
    except (ValueError, OverflowError) as error:
        raise FormatError(
            f"'Frame Time: {file.frame_time[:40]}' is not a usable time between frames in seconds ({error}); "
            "correct it, or give the framerate",
            path=path,
            reason="frame-time",
            line=file.frame_time_line,
        ) from None


@lru_cache(maxsize=256)
def _fps_of(frame_time: str) -> Fraction:
    # Cached: a corpus has few different frame times.
    seconds = float(frame_time)
    if not seconds > 0:
        raise ValueError("it must be positive")
    return parse_fps(1.0 / seconds)
