"""Constraints from the options of `motionkit generate`: a table of a path, poses of files, joints at places.

A path is a CSV with the columns `x` and `z` (metres), optionally `seconds` and `heading_degrees`. Without seconds it
is walked evenly over the whole motion. A pose is `SECONDS=FILE`, or `SECONDS=FILE@INSTANT` of a file of several
frames; a joint is `NAME@SECONDS=x,y,z` or `NAME@FROM-TO=x,y,z`.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motionkit.core.errors import MotionkitError, UsageError, shown
from motionkit.core.shapes import Float64
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import map_joints
from motionkit.generate.constraints import Constraint
from motionkit.generate.request import Prompt, read_csv
from motionkit.io.files import read

COLUMNS = ("seconds", "x", "z", "heading_degrees")
_JOINT = re.compile(r"(?P<joint>[^@=]+)@(?P<start>[\d.]+)(-(?P<end>[\d.]+))?=(?P<place>.+)")


@dataclass(frozen=True, eq=False)
class PathTable:
    """The points of a path: (x, z) in metres, seconds, heading (radians); None if not given."""

    name: str
    places: Float64[np.ndarray, "points 2"]
    seconds: Float64[np.ndarray, "points"] | None
    heading: Float64[np.ndarray, "points"] | None

    def constraint(self, duration_seconds: float | None) -> Constraint:
        """The path constraint for a motion's duration; raises `UsageError` if that is unknown but needed."""
        seconds = self.seconds
        if seconds is None:
            if duration_seconds is None:
                raise UsageError(
                    f"{self.name}: without a column 'seconds' the path is walked evenly, which needs --seconds"
                )
            steps = np.linalg.norm(np.diff(self.places, axis=0), axis=1)
            if not steps.all():
                raise UsageError(f"{self.name}: the same point twice; a path that rests says so by its seconds")
            seconds = np.concatenate(([0.0], steps.cumsum())) * (duration_seconds / steps.sum())
        elif duration_seconds is not None and seconds[-1] > duration_seconds + 1e-9:
            raise UsageError(f"{self.name}: {seconds[-1]:g} s lies outside the motion's 0 … {duration_seconds:g} s")
        return Constraint.path(self.places, seconds, self.heading, self.name)


def read_path(path: Path) -> PathTable:
    """Read a CSV of a path; raises `UsageError` with file and line for a row that is not of numbers."""
    rows = []
    for line, cells in read_csv(path):
        if not {"x", "z"} <= cells.keys() <= set(COLUMNS):
            raise UsageError(f"{path}, line 1: expected the columns x and z, perhaps {COLUMNS[0]} and {COLUMNS[3]}")
        rows.append([_number(cell, f"{path}, line {line}: {name}") for name, cell in cells.items()])
    if len(rows) < 2:
        raise UsageError(f"{path}: a path has two points or more, not {len(rows)}")
    column = dict(zip(cells, np.array(rows).T, strict=True))
    heading = np.radians(column[COLUMNS[3]]) if COLUMNS[3] in column else None
    return PathTable(path.name, np.stack((column["x"], column["z"]), axis=1), column.get("seconds"), heading)


def path_and_seconds(path: Path | None, seconds: float | None) -> tuple[PathTable | None, float | None]:
    """The path of a file, if given, and the motion's duration: as stated, else that of a path with seconds.

    Raises what `read_path` raises.
    """
    table = None if path is None else read_path(path)
    if seconds is None and table is not None and table.seconds is not None:
        seconds = float(table.seconds[-1])
    return table, seconds


def parse_constraints(
    path: PathTable | None,
    is_joined: bool,
    prompts: Sequence[Prompt],
    poses: Sequence[str] | None,
    places: Sequence[str] | None,
    *,
    joints: str | None = None,
    placed: bool = False,
) -> tuple[Constraint, ...]:
    """All constraints of a motion.

    `joints` are the constrained joints of poses, separated by commas; None for all. Raises what reading them raises,
    and `UsageError` for a path point beyond the motion's end, and for options of poses without poses.
    """
    if (joints or placed) and not poses:
        raise UsageError("--pose-joints and --pose-placed are about the poses of --pose: give one")
    lengths = [prompt.request.duration_seconds for prompt in prompts]
    length = lengths[0] if len(set(lengths)) == 1 else None
    if is_joined:
        length = None if None in lengths else sum(each or 0.0 for each in lengths)
    names = joints.split(",") if joints else SMPL22.joint_names
    of_path = [] if path is None else [path.constraint(length)]
    return (
        *of_path,
        *(parse_pose(each, names, placed=placed) for each in poses or ()),
        *map(parse_joint, places or ()),
    )


def _number(cell: str, place: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise UsageError(f"{place} is a number, not {shown(cell)}")
    return value


def parse_pose(given: str, joints: Sequence[str] = SMPL22.joint_names, *, placed: bool = False) -> Constraint:
    """Parse the pose of `SECONDS=FILE` or `SECONDS=FILE@INSTANT`, in the 22-joint layout.

    Raises `UsageError` for another form, a file of several frames without an instant, and an instant outside it.
    """
    from scipy.interpolate import interp1d

    stated, separator, name = given.partition("=")
    if not separator or not name or not _is_number(stated):
        raise UsageError(f"--pose takes SECONDS=FILE or SECONDS=FILE@INSTANT (2.0=clip.bvh@1.5), not {given!r}")
    file, _, last = name.rpartition("@")
    seconds, instant = float(stated), float(last) if file and _is_number(last) else None
    path = Path(name if instant is None else file)
    motion = read(path)
    try:
        positions = map_joints(motion, SMPL22.name).astype(np.float64)
    except MotionkitError as error:
        raise UsageError(f"{path}: {error}") from None
    times = motion.timegrid.seconds()
    if instant is None and len(times) > 1:
        raise UsageError(
            f"{path} holds {len(times):,} frames: say which by its second (--pose {stated}={path}@{times[0]:g})"
        )
    if instant is not None and not times[0] - 1e-6 <= instant <= times[-1] + 1e-6:
        raise UsageError(f"{path}: {instant:g} s lies outside its {times[0]:g} … {times[-1]:g} s")
    pose = positions[0]
    if instant is not None and len(times) > 1:
        pose = interp1d(times, positions, axis=0)(np.clip(instant, times[0], times[-1]))
    return Constraint.pose(pose, seconds, joints=joints, placed=placed, name=f"{name} at {seconds:g} s")


def parse_joint(given: str) -> Constraint:
    """Parse the joint of `NAME@SECONDS=x,y,z` or `NAME@FROM-TO=x,y,z`; raises `UsageError` for another form."""
    match = _JOINT.fullmatch(given)
    numbers = [match["start"], match["end"] or match["start"], *match["place"].split(",")] if match else []
    if match is None or len(numbers) != 5 or not all(map(_is_number, numbers)):
        raise UsageError(f"--joint takes NAME@FROM-TO=x,y,z (left_foot@1.0-1.4=0.2,0.05,1), not {given!r}")
    start, end, x, y, z = map(float, numbers)
    if end < start:
        raise UsageError(f"--joint {given}: {end:g} s lies before {start:g} s")
    return Constraint.joint(match["joint"], (x, y, z), start, end, name=given)


def _is_number(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False
