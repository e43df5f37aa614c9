"""BVH (BioVision Hierarchy): a text file of joints with offsets and channels, then one line of numbers a frame.

Channels are degrees and file units; a joint's rotation is the product of its rotation channels in the order in which
they are listed; position channels replace the joint's OFFSET. Source: M. Meredith and S. Maddock, "Motion Capture File
Formats Explained", University of Sheffield CS-01-11, 2001.
"""

from collections.abc import Iterable
from dataclasses import replace
from fractions import Fraction
from itertools import chain
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64

from motionkit.core import kinematics
from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion, Provenance
from motionkit.core.skeleton import Skeleton
from motionkit.core.skeletons.families import with_layout_map
from motionkit.core.timegrid import TimeGrid
from motionkit.formats.bvh import channels as bvh_channels
from motionkit.formats.bvh.channels import ChannelPose
from motionkit.formats.bvh.tables import parts_of, read_tables
from motionkit.formats.bvh.text import read_head, stated_fps
from motionkit.formats.scan.items import ReadOptions
from motionkit.formats.source import body_frame, clock, number_table
from motionkit.formats.source.joint_channels import joint_channels
from motionkit.formats.source.source_file import FileParts

# Bones that change by less are noise of printed digits; a bone that changes by more is not rigid.
RIGID_METRES = 1e-3
# The log line by which readers of whole data sets know that frames count from one later.
T_POSE_DROPPED = "frame 0 dropped: a T-pose (root unturned, all angles whole degrees, root where frame 1 is)"
WRITTEN_DECIMALS = 6
# A file as large as this is read at once, a larger one piece by piece.
HELD_BYTES = 8 << 20


def read_bvh(path: Path, options: ReadOptions | None = None) -> Motion:
    """Read one BVH file: positions in metres, y up, true local rotations, at the stated framerate.

    The unit is `options.unit_metres` or inferred (`body_frame.infer_unit`); a T-pose in frame 0, as B. Hahne's
    conversions of the CMU database have it, is dropped; a z-up body is turned. All of it is in the operation log.
    Raises `FormatError` with a reason, the line and the frame.
    """
    options = options or ReadOptions()
    file = FileParts.of(path, held_bytes=HELD_BYTES)
    head = read_head(file)
    fps, operations = clock.fps_in_use(options.fps, lambda: stated_fps(head, path))
    tables = read_tables(file, head)
    first, num_frames = next(tables), head.num_frames
    if bvh_channels.starts_with_t_pose(first, head.hierarchy):
        first, num_frames = first[1:], num_frames - 1
        operations.append(T_POSE_DROPPED)
    pieces = (
        bvh_channels.fold_reference(bvh_channels.read_channels(table, head.hierarchy, path.stem))
        for table in chain([first], tables)
    )
    pose = bvh_channels.join(pieces, num_frames)
    pose = replace(pose, skeleton=with_layout_map(pose.skeleton, options.skeleton_maps))
    motion = _to_motion(pose, fps, options, path)
    provenance = Provenance(
        source_path=path.name,
        source_sha256=file.sha256(),
        source_format="bvh",
        stated_fps=f"Frame Time: {head.frame_time}",
        operations=(*operations, *motion.provenance.operations),
    )
    return replace(motion, provenance=provenance)


def _to_motion(pose: ChannelPose, fps: Fraction, options: ReadOptions, path: Path) -> Motion:
    unit, reason = _unit(pose, options, path)
    pose = bvh_channels.settle_offsets(pose, RIGID_METRES / unit)
    skeleton = pose.skeleton.scaled(unit)
    operations = [*pose.operations, f"lengths × {unit:.6g} to metres ({reason})"]
    if pose.placed_joints:
        names = ", ".join(skeleton.joint_names[joint] for joint in pose.placed_joints)
        operations.append(f"positions only: these bones change their length or place ({names})")
    root = (pose.root * unit).astype(np.float32)
    positions = _positions(pose, root, skeleton, unit)
    rotations = np.ascontiguousarray(pose.rotations)
    if body_frame.is_z_up(skeleton, positions):
        for part in parts_of(len(root)):
            turned = body_frame.z_up_to_y_up(skeleton, positions[part], rotations[part], root[part])
            _, positions[part], rotations[part], root[part] = turned
        skeleton = body_frame.skeleton_to_y_up(skeleton)
        operations.append("turned from z up to y up: (x, y, z) → (x, z, −y)")
    return Motion(
        joint_positions=positions,
        skeleton=skeleton,
        timegrid=TimeGrid(fps, len(positions)),
        local_rotations=None if pose.placed_joints else rotations,
        root_translation=None if pose.placed_joints else root,
        sequence_id=path.stem,
        provenance=Provenance(operations=tuple(operations)),
    )


def _positions(
    pose: ChannelPose, root: Float32[np.ndarray, "frames 3"], skeleton: Skeleton, unit: float
) -> Float32[np.ndarray, "frames joints 3"]:
    positions = np.empty((len(root), skeleton.num_joints, 3), np.float32)
    for part in parts_of(len(root)):
        offsets = None
        if pose.placed_joints:
            offsets = np.repeat(skeleton.offsets[None], len(root[part]), axis=0)
            offsets[:, list(pose.placed_joints)] = pose.places[part] * unit
        positions[part] = kinematics.forward_kinematics(pose.rotations[part], root[part], skeleton, offsets)
    return positions


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
