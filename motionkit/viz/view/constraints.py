"""Draws the constraints of a generated motion: its path on the floor, and target poses."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from motionkit.core.errors import UsageError
from motionkit.core.shapes import Float64
from motionkit.core.skeleton import SMPL22
from motionkit.features.field import heading, to_world
from motionkit.features.layout import SMPL22_LAYOUT
from motionkit.generate.constraint_files import PathTable, parse_pose, read_path
from motionkit.generate.constraints import Constraint
from motionkit.viz.player.takes import Line, Take


def constraint_drawing(path: Path | None, poses: Sequence[str], placed: bool) -> Callable[[Take], Take]:
    """`with_constraints` for options of `motionkit generate`: a path's file, and poses; raises what reading raises."""
    table, parsed = None if path is None else read_path(path), [parse_pose(each, placed=placed) for each in poses]
    return lambda take: with_constraints(take, table, parsed)


def with_constraints(take: Take, path: PathTable | None, poses: Sequence[Constraint]) -> Take:
    """Add lines to a take: the path, on the floor, and the bones of poses.

    A pose without a position is drawn where the motion is at its time. Raises `UsageError` for a path point beyond the
    motion's end, and for such a pose if the motion does not have the 22 joints.
    """
    lines: list[Line] = []
    if path is not None:
        lines.append(path.constraint(take.duration_seconds).positions[:, 0])
    for pose in poses:
        placed = _placed(take, pose)
        bones = [placed[[parent, joint]] for joint, parent in enumerate(SMPL22.parents) if parent >= 0]
        lines += [bone for bone in bones if np.isfinite(bone).all()]
    return replace(take, lines=tuple(lines))


def _placed(take: Take, pose: Constraint) -> Float64[np.ndarray, "22 3"]:
    """All 22 joints of a pose in the take's world; unconstrained ones are NaN."""
    joints = np.full((SMPL22.num_joints, 3), np.nan)
    joints[pose.joint_indices] = pose.positions[0]
    if pose.frame == "world":
        return joints
    if take.skeleton.joint_names != SMPL22.joint_names:
        raise UsageError(f"{take.name}: a pose is shown with motions of the 22 joints of {SMPL22.name}")
    frame = int(np.abs(take.frame_seconds() - pose.seconds[0]).argmin())
    here = take.joint_positions[[frame]].astype(np.float64)
    yaw, place = heading(here, SMPL22_LAYOUT.facing), here[:, 0, [0, 2]]
    return np.asarray(to_world(joints[None, None], yaw, place)[0, 0], np.float64)
