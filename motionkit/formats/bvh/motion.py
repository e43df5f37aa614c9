"""BVH (BioVision Hierarchy): a text file of joints with offsets and channels, then one line of numbers a frame.

Channels are degrees and file units; a joint's rotation is the product of its rotation channels in the order in which
they are listed; position channels replace the joint's OFFSET. Source: M. Meredith and S. Maddock, "Motion Capture File
Formats Explained", University of Sheffield CS-01-11, 2001.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from motionkit import kinematics
from motionkit.errors import FormatError
from motionkit.formats import body_frame, clock, number_table, sourcefile
from motionkit.formats.bvh import channels as bvh_channels
from motionkit.formats.bvh.channels import ChannelPose
from motionkit.formats.bvh.hierarchy import BvhHierarchy, parse_hierarchy
from motionkit.formats.items import ReadOptions
from motionkit.formats.joint_channels import joint_channels
from motionkit.motion import Motion, Provenance
from motionkit.skeleton import Skeleton
from motionkit.skeleton_families import with_layout_map
from motionkit.timegrid import TimeGrid, parse_fps

# Bones that change by less are noise of printed digits; a bone that changes by more is not rigid.
RIGID_METRES = 1e-3
# The log line by which readers of whole data sets know that frames count from one later.
T_POSE_DROPPED = "frame 0 dropped: a T-pose (root unturned, all angles whole degrees, root where frame 1 is)"
WRITTEN_DECIMALS = 6


@dataclass(frozen=True)
class _File:
    hierarchy: BvhHierarchy
    num_frames: int
    frame_time: str
    frame_time_line: int
    body: bytes
    body_line: int


def read_bvh(path: Path, options: ReadOptions | None = None) -> Motion:
    """Read one BVH file: positions in metres, y up, true local rotations, at the stated framerate.

    The unit is `options.unit_metres` or inferred (`body_frame.infer_unit`); a T-pose in frame 0, as B. Hahne's
    conversions of the CMU database have it, is dropped; a z-up body is turned. All of it is in the operation log.
    Raises `FormatError` with a reason, the line and the frame.
    """
    options = options or ReadOptions()
    data = sourcefile.read_bytes(path)
    # Lines of old Macintoshes end in a carriage return alone.
    file = _split(data if b"\n" in data else data.replace(b"\r", b"\n"), path)
    fps, operations = clock.fps_in_use(options.fps, lambda: _stated_fps(file, path))
    table = number_table.parse_table(
        file.body,
        num_rows=file.num_frames,
        num_columns=file.hierarchy.num_channels,
        path=path,
        first_line=file.body_line,
    )
    if bvh_channels.starts_with_t_pose(table, file.hierarchy):
        table = table[1:]
        operations.append(T_POSE_DROPPED)
    pose = bvh_channels.fold_reference(bvh_channels.read_channels(table, file.hierarchy, path.stem))
    pose = replace(pose, skeleton=with_layout_map(pose.skeleton, options.skeleton_maps))
    motion = _to_motion(pose, fps, options, path)
    provenance = Provenance(
        source_path=path.name,
        source_sha256=sourcefile.sha256(data),
        source_format="bvh",
        stated_fps=f"Frame Time: {file.frame_time}",
        operations=(*operations, *motion.provenance.operations),
    )
    return replace(motion, provenance=provenance)


def _to_motion(pose: ChannelPose, fps: Fraction, options: ReadOptions, path: Path) -> Motion:
    unit, reason = _unit(pose, options, path)
    pose = bvh_channels.settle_offsets(pose, RIGID_METRES / unit)
    skeleton = pose.skeleton.scaled(unit)
    operations = [*pose.operations, f"lengths × {unit:.6g} to metres ({reason})"]
    offsets = None
    if pose.placed_joints:
        offsets = np.repeat(skeleton.offsets[None], len(pose.root), axis=0)
        offsets[:, list(pose.placed_joints)] = pose.places * unit
        names = ", ".join(skeleton.joint_names[joint] for joint in pose.placed_joints)
        operations.append(f"positions only: these bones change their length or place ({names})")
    rotations, root = pose.rotations, (pose.root * unit).astype(np.float32)
    positions = kinematics.forward_kinematics(rotations, root, skeleton, offsets)
    if body_frame.is_z_up(skeleton, positions):
        skeleton, positions, rotations, root = body_frame.z_up_to_y_up(skeleton, positions, rotations, root)
        operations.append("turned from z up to y up: (x, y, z) → (x, z, −y)")
    return Motion(
        joint_positions=positions,
        skeleton=skeleton,
        timegrid=TimeGrid(fps, len(positions)),
        local_rotations=None if pose.placed_joints else np.ascontiguousarray(rotations),
        root_translation=None if pose.placed_joints else root,
        sequence_id=path.stem,
        provenance=Provenance(operations=tuple(operations)),
    )


def _unit(pose: ChannelPose, options: ReadOptions, path: Path) -> tuple[float, str]:
    if options.unit_metres is not None:
        return options.unit_metres, "given"
    unit = body_frame.infer_unit(bvh_channels.first_skeleton(pose))
    if unit is None:
        raise FormatError(
            "in none of m, cm, mm, inch and the CMU database's unit is this skeleton the size of a human body; "
            "say how long a unit is with --unit-metres",
            path=path,
            reason="unit",
        )
    return unit.metres, unit.reason


def _split(data: bytes, path: Path) -> _File:
    head = data[:4096].removeprefix(b"\xef\xbb\xbf").lstrip()
    if not head[:9].upper().startswith(b"HIERARCHY"):
        raise FormatError(
            f"looks like {sourcefile.describe_content(data)}, expected a BVH file that begins with HIERARCHY",
            path=path,
            reason="not-what-it-says",
            line=1,
        )
    motion = re.search(rb"(?m)^[ \t]*MOTION[ \t]*\r?$", data)
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
    while not (frames and frame_time):
        end = data.find(b"\n", position)
        end = len(data) if end < 0 else end
        line = data.count(b"\n", 0, position) + 1
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
    body_line = data.count(b"\n", 0, min(position, len(data))) + 1
    return _File(
        hierarchy, _num_frames(frames, path, body_line), frame_time, frame_time_line, data[position:], body_line
    )


def _num_frames(stated: str, path: Path, body_line: int) -> int:
    if not (stated.isascii() and stated.isdecimal() and len(stated) < 12):
        raise FormatError(
            f"'Frames: {stated[:40]}', expected a whole number", path=path, reason="frame-count", line=body_line
        )
    if int(stated) == 0:
        raise FormatError("0 frames, expected at least one", path=path, reason="no-frames", line=body_line)
    return int(stated)


def _stated_fps(file: _File, path: Path) -> Fraction:
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


def write_bvh(motion: Motion, path: Path, *, unit_metres: float = 0.01) -> None:
    """Write a motion with its skeleton: centimetres unless `unit_metres` says otherwise, ZXY rotations, six decimals.

    Reading it back gives the same framerate, the joints (depth first), and positions within 0.15 mm. A motion without
    rotations gets them by inverse kinematics; where rigid bones would miss its positions by more than 0.1 mm, every
    joint gets position channels. The frame time is written with all its digits.
    """
    channels = joint_channels(motion)
    skeleton, translations = channels.skeleton, channels.translations
    angles = np.degrees(_zxy_angles(kinematics.quaternion_to_matrix(channels.rotations.astype(np.float64))))
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
    # R = Rz·Rx·Ry; at the pole, where only z ± y is determined, y is set to zero.
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
