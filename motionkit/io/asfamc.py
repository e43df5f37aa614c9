"""AMC motions over ASF skeletons, as the CMU motion capture database publishes them.

A bone's local rotation is L = C·R(dof)·C⁻¹, its global one parent·L, its end start + global·(direction·length). Joints
are at the starts of bones (`asf.AsfSkeleton`), so L is the joint's local rotation. AMC does not state a framerate.
Source: http://mocap.cs.cmu.edu, and the page named in `asf`.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32, Float64
from motionkit.core.timegrid import TimeGrid
from motionkit.io import source_file
from motionkit.io.asf import ROTATIONS, AsfSkeleton, read_asf
from motionkit.io.number_table import (
    INLINE_BYTES,
    Words,
    blocks,
    find_words,
    parse_number,
    to_numbers,
)
from motionkit.io.registry import Format, ReadOptions, of_path


@dataclass(frozen=True)
class AmcTable:
    """Channel values [T, channels] in the order of `bones` (name, number of channels), and the first frame's number."""

    values: Float64[np.ndarray, "frames channels"]
    bones: tuple[tuple[str, int], ...]
    first_frame_number: int


def read_asfamc(path: Path, options: ReadOptions | None = None, skeleton_path: Path | None = None) -> Motion:
    """Read one AMC file and the ASF skeleton beside it: positions in metres, y up, true local rotations.

    The skeleton is `skeleton_path`, or SUBJECT.asf for SUBJECT_TAKE.amc, or the folder's only ASF file. Raises
    `FormatError`, with the reason `no-framerate` without `options.fps`, since AMC does not state a framerate.
    """
    options = options or ReadOptions()
    data = source_file.read_bytes(path)
    if options.fps is None:
        raise FormatError(
            "AMC files don't state their framerate; give it in the column 'fps' of an annotation CSV beside them, or "
            "with --fps (the CMU database: 120, some takes 60)",
            path=path,
            reason="no-framerate",
        )
    asf = read_asf(skeleton_path or find_skeleton(path), options.unit_metres)
    table = parse_amc(data, path)
    rotations, root = _local_rotations(table, asf, path)
    operations = [
        f"lengths × {asf.unit_metres:.6g} to metres ({'given' if options.unit_metres else 'ASF length unit'})"
    ]
    if table.first_frame_number != 1:
        operations.append(f"AMC frame numbers start at {table.first_frame_number}")
    return Motion(
        joint_positions=kinematics.forward_kinematics(rotations, root, asf.skeleton),
        skeleton=asf.skeleton,
        timegrid=TimeGrid(options.fps, len(table.values)),
        local_rotations=np.ascontiguousarray(rotations),
        root_translation=root,
        sequence_id=path.stem,
        provenance=source_file.provenance(path, data, "asfamc", operations),
    )


def find_skeleton(path: Path) -> Path:
    """The ASF file of an AMC file; raises `FormatError` (`no-skeleton`, `two-skeletons`)."""
    found = sorted(entry for entry in path.parent.iterdir() if entry.suffix.lower() == ".asf")
    subjects = {path.stem.lower(), path.stem.rsplit("_", 1)[0].lower()}
    named = [entry for entry in found if entry.stem.lower() in subjects]
    if len(named) == 1:
        return named[0]
    if len(found) == 1:
        return found[0]
    if not found:
        raise FormatError("no ASF skeleton in its folder, expected one", path=path, reason="no-skeleton")
    raise FormatError(
        f"its folder holds {len(found)} skeletons ({', '.join(entry.name for entry in found)}), expected one "
        f"or {path.stem.rsplit('_', 1)[0]}.asf",
        path=path,
        reason="two-skeletons",
    )


def parse_amc(data: bytes, path: Path) -> AmcTable:
    """The channel values of all frames; raises `FormatError` naming the line and the frame.

    Files whose frames all have the layout of the first one, as those written by programs do, are parsed by array
    operations.
    """
    start = re.search(rb"(?m)^[ \t]*\d+[ \t]*\r?$", data)
    if start is None or b":FULLY-SPECIFIED" not in data[: start.start()].upper():
        raise FormatError(
            f"looks like {source_file.describe_content(data)}, expected an AMC file with :FULLY-SPECIFIED and frames",
            path=path,
            reason="not-what-it-says",
        )
    if b":RADIANS" in data[: start.start()].upper():
        raise FormatError("angles in radians, expected :DEGREES", path=path, reason="radians")
    body = data[start.start() :].strip() + b"\n"
    second = re.search(rb"\n[ \t]*\d+[ \t\r]*\n", body)
    first = body if second is None else body[: second.start() + 1]
    words = [line.split() for line in first.splitlines()[1:] if line.strip()]
    if not words:
        line = data[: start.start()].count(b"\n") + 1
        raise FormatError("the first frame has no bones", path=path, reason="truncated", line=line, frame=0)
    bones = tuple((name.decode("utf-8", "replace"), len(numbers)) for name, *numbers in words)
    values = _parse_regular(body, first)
    if values is None:
        return _parse_slowly(data, bones, path)
    numbers = values[:, 0]
    return AmcTable(np.delete(values, 0, axis=1), bones, int(numbers[0]))


def _parse_regular(body: bytes, first: bytes) -> Float64[np.ndarray, "frames values"] | None:
    # Frame numbers and channel values, or None if a frame deviates from the first one's layout: the same names at the
    # same positions in the same lines, and numbers elsewhere.
    pattern = find_words(first)
    width = len(pattern.starts)
    is_name = pattern.opens_line.copy()
    is_name[0] = False
    names = pattern.take(np.flatnonzero(is_name))
    if names.lengths.max(initial=0) > INLINE_BYTES:
        return None
    frames = []
    rest = b""
    for block in blocks(body):
        words = find_words(rest + block)
        whole = len(words.starts) // width * width
        if not whole:
            return None
        rest = words.padded[words.starts[whole] :].rstrip() + b"\n" if whole < len(words.starts) else b""
        places = np.arange(whole).reshape(-1, width)
        opens_line = words.opens_line[places]
        if (opens_line != pattern.opens_line).any() or not _same_words(words.take(places[:, is_name]), names):
            return None
        values = to_numbers(words.take(places[:, ~is_name]))
        if values is None:
            return None
        frames.append(values.reshape(len(places), -1))
    numbers = np.concatenate(frames)
    if rest or (np.diff(numbers[:, 0]) != 1).any() or numbers[0, 0] % 1:
        return None
    return numbers


def _same_words(words: Words, expected: Words) -> bool:
    # Whether the words are the expected ones, repeated; only the first 12 bytes are compared.
    repeats = len(words.starts) // max(1, len(expected.starts))
    if (words.lengths.reshape(repeats, -1) != expected.lengths).any():
        return False
    counts = np.arange(INLINE_BYTES) < expected.lengths[:, None]
    letters = words.inline().view(np.uint8).reshape(repeats, -1, INLINE_BYTES)
    return bool(((letters == expected.inline().view(np.uint8).reshape(-1, INLINE_BYTES)) | ~counts).all())


def _parse_slowly(data: bytes, bones: Sequence[tuple[str, int]], path: Path) -> AmcTable:
    expected = dict(bones)
    if len(expected) != len(bones):
        raise FormatError("a bone is listed twice in the first frame", path=path, reason="bones")
    columns = dict(zip(expected, accumulate(expected.values(), initial=0), strict=False))
    frames: list[list[float]] = []
    numbers: list[int] = []
    seen: set[str] = set()
    line = 0
    for line, text in enumerate(data.splitlines(), start=1):
        words = text.split()
        if not words or words[0][:1] in (b"#", b":"):
            continue
        if len(words) == 1 and words[0].isdigit():
            _check_complete(seen, expected, frames, path, line)
            number = int(words[0][:15])
            if numbers and number != numbers[-1] + 1:
                raise FormatError(
                    f"frame number {number} after {numbers[-1]}, expected {numbers[-1] + 1}",
                    path=path,
                    reason="frame-number",
                    line=line,
                    frame=len(frames),
                )
            numbers.append(number)
            frames.append([0.0] * sum(expected.values()))
            seen = set()
            continue
        frame = len(frames) - 1
        name = words[0].decode("utf-8", "replace")
        if not frames or name not in expected or name in seen:
            raise FormatError(
                f"{name[:40]!r}, expected a frame number or a bone of the first frame, each once",
                path=path,
                reason="bones",
                line=line,
                frame=max(frame, 0),
            )
        if len(words) - 1 != expected[name]:
            raise FormatError(
                f"{len(words) - 1} numbers for {name}, expected {expected[name]}",
                path=path,
                reason="channel-count",
                line=line,
                frame=frame,
            )
        seen.add(name)
        frames[-1][columns[name] : columns[name] + expected[name]] = [
            parse_number(word, path, line, frame) for word in words[1:]
        ]
    _check_complete(seen, expected, frames, path, line)
    return AmcTable(np.array(frames, dtype=np.float64).reshape(len(frames), -1), tuple(bones), numbers[0])


def _check_complete(seen: set[str], expected: dict[str, int], frames: Sequence[object], path: Path, line: int) -> None:
    if frames and len(seen) < len(expected):
        missing = [name for name in expected if name not in seen]
        raise FormatError(
            f"the frame ends without {', '.join(missing[:4])}{' …' if len(missing) > 4 else ''}; "
            f"expected {len(expected)} bones",
            path=path,
            reason="truncated",
            line=line,
            frame=len(frames) - 1,
        )


def _local_rotations(
    table: AmcTable, asf: AsfSkeleton, path: Path
) -> tuple[Float32[np.ndarray, "frames joints 4"], Float32[np.ndarray, "frames 3"]]:
    num_frames = len(table.values)
    names = [bone.name for bone in asf.bones]
    rotations = np.zeros((num_frames, len(names), 4), np.float32)
    rotations[..., 0] = 1.0
    root = np.repeat(asf.root_position[None], num_frames, axis=0)
    frames = asf.axis_frames
    column = 0
    for name, count in table.bones:
        if name not in names:
            raise FormatError(f"bone {name!r} is not in the skeleton", path=path, reason="bones")
        joint = names.index(name)
        bone = asf.bones[joint]
        if len(bone.dof) != count:
            raise FormatError(
                f"{count} numbers for {name}, but the skeleton gives it {len(bone.dof)} ({' '.join(bone.dof)})",
                path=path,
                reason="channel-count",
                frame=0,
            )
        values = table.values[:, column : column + count]
        column += count
        turning = [place for place, dof in enumerate(bone.dof) if dof in ROTATIONS]
        for place, dof in enumerate(bone.dof):
            if dof not in ROTATIONS:
                root[:, "xyz".index(dof[1])] += values[:, place]
        if turning:
            angles = values[:, turning] * (np.pi / 180.0 if asf.degrees else 1.0)
            order = "".join(ROTATIONS[bone.dof[place]] for place in turning)
            turn = kinematics.euler_to_quaternion(angles, order, kind="extrinsic")
            frame = frames[joint]
            back = kinematics.quaternion_conjugate(frame)
            turn = kinematics.quaternion_multiply(kinematics.quaternion_multiply(frame, turn), back)
            rotations[:, joint] = turn
    return rotations, (root * asf.unit_metres).astype(np.float32)


FORMAT = Format(
    name="asfamc",
    read=of_path(read_asfamc),
    suffixes=(".amc",),
    beside=("*.asf",),
    begins=b":FULLY-SPECIFIED",
)
