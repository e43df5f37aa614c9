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

from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.plain_text import shown
from motionkit.core.shapes import Float64
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import map_joints
from motionkit.generate.constraints import Constraint
from motionkit.generate.request import Prompt, read_csv, read_text
from motionkit.store.named_motions.reading import read

COLUMNS = ("seconds", "x", "z", "heading_degrees")
_JOINT = re.compile(r"(?P<joint>[^@=]+)@(?P<start>[\d.]+)(-(?P<end>[\d.]+))?=(?P<place>.+)")


@dataclass(frozen=True, eq=False)
class PathTable:
    """The points of a path with their line numbers: (x, z) in metres, seconds, heading (radians); None if not given."""

    name: str
    places: Float64[np.ndarray, "points 2"]
    seconds: Float64[np.ndarray, "points"] | None
    heading: Float64[np.ndarray, "points"] | None
    lines: tuple[int, ...]

    def constraint(self, duration_seconds: float | None) -> Constraint:
        """The path constraint for a motion's duration; raises `UsageError` if that is unknown but needed."""
        if self.seconds is not None:
            late = np.flatnonzero(self.seconds > (np.inf if duration_seconds is None else duration_seconds + 1e-9))
            if len(late):
                beyond = f"{self.seconds[late[0]]:g} s lies outside the motion's 0 … {duration_seconds:g} s"
                raise UsageError(f"{self.name}, line {self.lines[late[0]]}: {beyond}")
            return Constraint.path(self.places, self.seconds, self.heading, self.name)
        if duration_seconds is None:
            raise UsageError(
                f"{self.name}: without a column 'seconds' the path is walked evenly, which needs --seconds"
            )
        steps = np.linalg.norm(np.diff(self.places, axis=0), axis=1)
        seconds = np.concatenate(([0.0], steps.cumsum())) * (duration_seconds / steps.sum())
        return Constraint.path(self.places, seconds, self.heading, self.name)


def read_path(path: Path) -> PathTable:
    """Read a CSV of a path; raises `UsageError` with file and line for an invalid one."""

    def check(names: Sequence[str]) -> None:
        if not {"x", "z"} <= set(names) <= set(COLUMNS):
            raise UsageError(f"{path}, line 1: expected the columns x and z, perhaps {COLUMNS[0]} and {COLUMNS[3]}")

    rows: list[dict[str, float]] = []
    lines: list[int] = []
    for line, cells in read_csv(read_text(path), path, check):
        place = f"{path}, line {line}"
        row = {name: _number(cell, f"{place}: {name}") for name, cell in cells.items()}
        _check_step(rows[-1] if rows else None, row, place)
        rows.append(row)
        lines.append(line)
    if len(rows) < 2:
        raise UsageError(f"{path}: a path has two points or more, not {len(rows)}")
    column = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    heading = np.radians(column[COLUMNS[3]]) if COLUMNS[3] in column else None
    places = np.stack((column["x"], column["z"]), axis=1)
    return PathTable(path.name, places, column.get("seconds"), heading, tuple(lines))


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
    names = joints.split(",") if joints else SMPL22.joint_names
    lengths = [prompt.request.duration_seconds or np.nan for prompt in prompts]
    length = sum(lengths) if is_joined else lengths[0] if len(set(lengths)) == 1 else np.nan
    of_path = [] if path is None else [path.constraint(None if np.isnan(length) else length)]
    of_poses = [parse_pose(each, names, placed=placed) for each in poses or ()]
    return (*of_path, *of_poses, *map(parse_joint, places or ()))


def _number(cell: str, place: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise UsageError(f"{place} is a number, not {shown(cell)}")
    return value


def _check_step(before: dict[str, float] | None, row: dict[str, float], place: str) -> None:
    """Raise `UsageError` for a point that does not come after the one `before`."""
    seconds = row.get("seconds")
    if seconds is not None and seconds < 0:
        raise UsageError(f"{place}: {seconds:g} s lies before the motion, which begins at 0")
    if before is None:
        return
    if seconds is not None and seconds <= before["seconds"]:
        raise UsageError(f"{place}: {seconds:g} s does not come after the {before['seconds']:g} s before it")
    if seconds is None and (row["x"], row["z"]) == (before["x"], before["z"]):
        raise UsageError(f"{place}: the same point twice; a path that rests says so by its seconds")


def parse_pose(given: str, joints: Sequence[str] = SMPL22.joint_names, *, placed: bool = False) -> Constraint:
    """Parse the pose of `SECONDS=FILE` or `SECONDS=FILE@INSTANT`, in the 22-joint layout.

    Raises `UsageError` for another form, a file of several frames without an instant, and an instant outside it.
    """
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
        after = int(np.clip(np.searchsorted(times, instant), 1, len(times) - 1))
        share = np.clip((instant - times[after - 1]) / (times[after] - times[after - 1]), 0.0, 1.0)
        pose = positions[after - 1] + share * (positions[after] - positions[after - 1])
    return Constraint.pose(pose, seconds, joints=joints, placed=placed, name=f"{name} at {seconds:g} s")


def parse_joint(given: str) -> Constraint:
    """Parse the joint of `NAME@SECONDS=x,y,z` or `NAME@FROM-TO=x,y,z`; raises `UsageError` for another form."""
    found = _JOINT.fullmatch(given)
    numbers = found["place"].split(",") if found else []
    stated = [found["start"], found["end"] or found["start"]] if found else []
    if found is None or len(numbers) != 3 or not all(map(_is_number, (*numbers, *stated))):
        raise UsageError(f"--joint takes NAME@FROM-TO=x,y,z (left_foot@1.0-1.4=0.2,0.05,1), not {given!r}")
    start, end = map(float, stated)
    if end < start:
        raise UsageError(f"--joint {given}: {end:g} s lies before {start:g} s")
    x, y, z = map(float, numbers)
    return Constraint.joint(found["joint"], (x, y, z), start, end, name=given)


def _is_number(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False
