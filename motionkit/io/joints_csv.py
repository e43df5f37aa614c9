"""Joint positions as a CSV table: a row per frame, `time_seconds` or `frame`, then JOINT_x, JOINT_y, JOINT_z in metres.

The header names the joints; those of a standard layout, in any order, give that layout, otherwise all are children of
the first (tables have no bones). `frame` counts frames and needs a framerate from an annotation CSV or an option.
"""

import csv
import io
import re
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc

from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float64
from motionkit.core.skeleton import STANDARD_SKELETONS, Skeleton
from motionkit.core.skeletons.mapping import rig_name
from motionkit.core.timegrid import TimeGrid
from motionkit.io import source_file
from motionkit.io.body_frame import in_metres
from motionkit.io.npy import MAX_NUMBER
from motionkit.io.npz import bones_of_pose
from motionkit.io.registry import FileHead, ReadOptions

TIME, FRAME = "time_seconds", "frame"
AXES = ("x", "y", "z")
# In pyarrow's messages; rows are lines, the header is the first.
ROW = re.compile(r"Row #(\d+): ")


def accepts(head: FileHead) -> bool:
    """Whether a CSV's first row has a clock and at least one joint, and is not of `robot_csv`; reads no further."""
    names = head.column_names
    is_ours = any(name.endswith("_x") for name in names) and "root_qw" not in names
    return is_ours and (TIME in names or FRAME in names)


def read_joints_csv(path: Path, options: ReadOptions = ReadOptions()) -> Motion:
    """Read one table as positions in metres; `options.unit_metres` multiplies them, `options.fps` replaces the clock.

    Raises `FormatError` (`annotations` for a broken header, `channel-count`, `not-a-number`, `nan`, `frame-time` …).
    """
    data = source_file.read_bytes(path)
    names = header(data, path)
    joints = _joints(names, path)
    values = table(data, names, path)
    grid, stated, operations = _clock(values, names, options, path)
    skeleton = next((each for each in STANDARD_SKELETONS.values() if set(joints) == set(each.joint_names)), None)
    order = joints if skeleton is None else skeleton.joint_names
    columns = [names.index(f"{joint}_{axis}") for joint in order for axis in AXES]
    positions = values[:, columns].reshape(len(values), len(order), 3).astype(np.float32)
    if skeleton is None:
        parents = (-1, *(0,) * (len(order) - 1))
        skeleton = Skeleton(rig_name(order), order, parents, bones_of_pose(positions[0], parents))
    motion = Motion(
        joint_positions=positions,
        skeleton=skeleton,
        timegrid=grid,
        sequence_id=path.stem,
        provenance=source_file.provenance(path, data, "csv", operations, stated_fps=stated),
    )
    return in_metres(motion, options.unit_metres)


def write_joints_csv(motion: Motion, path: Path) -> None:
    """Write `time_seconds` and the positions in metres with all digits of float32."""
    arrays = {TIME: motion.timegrid.seconds()}
    for joint, name in enumerate(motion.skeleton.joint_names):
        for axis, letter in enumerate(AXES):
            arrays[f"{name}_{letter}"] = np.ascontiguousarray(motion.joint_positions[:, joint, axis])
    pc.write_csv(pa.table(arrays), path)


def header(data: bytes, path: Path) -> tuple[str, ...]:
    """The columns' names in the first line. Raises `FormatError` (`not-a-number`, `annotations`)."""
    text = source_file.decode(data[: source_file.HEADER_BYTES].partition(b"\n")[0], path)
    if ";" in text or "\t" in text:
        message = "columns are separated by ';' or tabs, expected commas, and points in numbers (1.5, not 1,5)"
        raise FormatError(message, path=path, reason="not-a-number", line=1)
    try:
        return tuple(name.strip() for name in next(csv.reader(io.StringIO(text), strict=True), []))
    except csv.Error as error:
        raise FormatError(f"the first row is no header ({error})", path=path, reason="annotations", line=1) from None


def _joints(names: tuple[str, ...], path: Path) -> tuple[str, ...]:
    """Joint names in order of appearance; every joint must have three columns, without any other columns."""
    joints = tuple(dict.fromkeys(name[:-2] for name in names if name[-2:] in ("_x", "_y", "_z")))
    expected = {f"{joint}_{axis}" for joint in joints for axis in AXES}
    odd = sorted(expected.symmetric_difference(set(names) - {TIME, FRAME}))
    if not joints or odd or len(set(names)) != len(names):
        what = f"{odd[0]!r} is one too many or missing" if odd else "a column is there twice, or there is no joint"
        message = f"{what}; expected {TIME} or {FRAME} and three columns JOINT_x, JOINT_y, JOINT_z for each joint"
        raise FormatError(message, path=path, reason="channel-count", line=1)
    return joints


def table(
    data: bytes, names: tuple[str, ...], path: Path, *, has_header: bool = True
) -> Float64[np.ndarray, "frames columns"]:
    """All numbers of a CSV file with these columns.

    Raises `FormatError` (`channel-count`, `not-a-number`, `nan`, `range`, `no-frames`) with the line or frame.
    """
    try:
        rows = pc.read_csv(
            pa.BufferReader(data),
            read_options=pc.ReadOptions(column_names=list(names), skip_rows=int(has_header), use_threads=False),
            convert_options=pc.ConvertOptions(column_types=dict.fromkeys(names, pa.float64()), null_values=[]),
        )
    except (pa.ArrowException, ValueError) as error:
        message = str(error).splitlines()[0][:160]
        row, reason = ROW.search(message), "channel-count" if " columns, got " in message else "not-a-number"
        raise FormatError(message, path=path, reason=reason, line=int(row[1]) if row else None) from None
    if not rows.num_rows:
        raise FormatError("0 frames, expected at least one row below the header", path=path, reason="no-frames")
    values = np.stack([rows[name].to_numpy() for name in names], axis=1)
    for reason, bad in (("nan", ~np.isfinite(values)), ("range", np.abs(values) > MAX_NUMBER)):
        if bad.any():
            frame, column = np.argwhere(bad)[0].tolist()
            message = f"{values[frame, column]} in column {names[column]!r}"
            raise FormatError(message, path=path, reason=reason, frame=frame)
    return values


def _clock(
    table: Float64[np.ndarray, "frames columns"], names: tuple[str, ...], options: ReadOptions, path: Path
) -> tuple[TimeGrid, str, list[str]]:
    if FRAME in names:
        steps = np.diff(table[:, names.index(FRAME)])
        if (steps != 1).any():
            frame = int(np.argmax(steps != 1)) + 1
            raise FormatError("frames do not count up by one", path=path, reason="frame-number", frame=frame)
    if TIME not in names:
        if options.fps is None:
            message = f"frames are counted, but nothing says the framerate; write {TIME}, or use --fps"
            raise FormatError(message, path=path, reason="no-framerate")
        return TimeGrid(options.fps, len(table)), "", []
    seconds = table[:, names.index(TIME)]
    stated = None
    try:
        stated = source_file.grid_of_seconds(seconds, path).fps
    except FormatError:
        if options.fps is None:
            raise
    fps = options.fps or stated
    assert fps is not None
    stated_words = "" if stated is None else f"{TIME}: {stated}"
    return TimeGrid(fps, len(seconds), float(seconds[0])), stated_words, source_file.replaced_fps(fps, stated)
