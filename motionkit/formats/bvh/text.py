"""A BVH file as text: the head with its hierarchy, the clock, and the lines of numbers, each still as written."""

import re
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from pathlib import Path

from motionkit.errors import FormatError
from motionkit.formats import sourcefile
from motionkit.formats.bvh.hierarchy import BvhHierarchy, parse_hierarchy
from motionkit.formats.file_parts import PART_BYTES, FileParts
from motionkit.timegrid import parse_fps

LARGEST_HEAD = 64 << 20
_MOTION = re.compile(rb"(?m)^[ \t]*MOTION[ \t]*\r?$")


@dataclass(frozen=True)
class BvhText:
    """What stands before the lines of numbers: `head` ends with the word MOTION; lines count from 1.

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
    """What stands before the numbers of a file, of which not much more is read; raises `FormatError` as `split_text`.

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
    """Take a file's beginning apart; raises `FormatError` naming the line for what is missing or no BVH file at all."""
    # Lines of old Macintoshes end in a carriage return alone.
    data = data if b"\n" in data else data.replace(b"\r", b"\n")
    head = data[:4096].removeprefix(b"\xef\xbb\xbf").lstrip()
    if not head[:9].upper().startswith(b"HIERARCHY"):
        raise FormatError(
            f"looks like {sourcefile.describe_content(data)}, expected a BVH file that begins with HIERARCHY",
            path=path,
            reason="not-what-it-says",
            line=1,
        )
    motion = _MOTION.search(data)
    if motion is None:
        hierarchy = parse_hierarchy(sourcefile.decode(data, path), path)
        raise FormatError(
            f"the file ends after the hierarchy of {len(hierarchy.joints)} joints, expected MOTION",
            path=path,
            reason="truncated",
            line=data.count(b"\n") + 1,
        )
    hierarchy = parse_hierarchy(sourcefile.decode(data[: motion.start()], path), path)
    if not hierarchy.num_channels:
        raise FormatError("no joint has CHANNELS, so nothing moves", path=path, reason="channels")
    position, frames, frame_time, frame_time_line = motion.end(), "", "", 0
    line = data.count(b"\n", 0, position)
    while not (frames and frame_time):
        end = data.find(b"\n", position)
        end = len(data) if end < 0 else end
        line += 1
        words = sourcefile.decode(data[position:end], path).strip()
        key, colon, value = words.partition(":")
        if words:
            match " ".join(key.lower().split()) if colon else "":
                case "frames":
                    frames = value.strip()
                case "frame time":
                    frame_time, frame_time_line = value.strip(), line
                case _:
                    missing = "Frame Time: seconds" if frames else "Frames: count"
                    raise FormatError(
                        f"{words[:40]!r} where '{missing}' was expected",
                        path=path,
                        reason="frame-time" if frames else "frame-count",
                        line=line,
                    )
        if end == len(data) and not (frames and frame_time):
            raise FormatError(
                "the file ends before its first frame, expected 'Frames:' and 'Frame Time:'",
                path=path,
                reason="truncated",
                line=line,
            )
        position = end + 1
    body_line = line + (position <= len(data))
    return BvhText(
        head=data[: motion.end()],
        hierarchy=hierarchy,
        num_frames=_num_frames(frames, path, body_line),
        frame_time=frame_time,
        frame_time_line=frame_time_line,
        body_start=position,
        body_line=body_line,
    )


def holds_head(data: bytes) -> bool:
    """Whether the beginning of a file that this is goes at least as far as its lines of numbers, or is no BVH file."""
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
    # The few frame times of a corpus come back in all of its files.
    seconds = float(frame_time)
    if not seconds > 0:
        raise ValueError("it must be positive")
    return parse_fps(1.0 / seconds)
