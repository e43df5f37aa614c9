"""Markers of a capture as joints without bones: C3D files and TRC tables, in metres and y up.

A motion of markers has the first marker as its root and all others as the root's children, with offsets of zero: a
skeleton that only names them. A `--skeleton-map` computes the 22 joints from them.

Of C3D all three number formats (Intel, DEC/VAX, MIPS) and both kinds of points (scaled integers, floats) are read, at
the point rate, and every size is checked against the file's bytes. No library is used (docs/deviations.md). Source:
"The C3D File Format User Guide", Motion Lab Systems 2021, https://www.c3d.org (units, screen axes, residuals, the lists
of points that are not positions).

TRC is OpenSim's text table of markers, or of joints from markerless systems. Five header lines (file, names of the
values, the values, names of the markers, axes), then one row per frame: number, time, x, y, z of every marker,
separated by tabs; empty cells, NaN and 0, 0, 0 are markers not visible. Source: OpenSim's user's guide, "Marker (.trc)
Files"; https://github.com/perfanalytics/pose2sim writes them.
"""

import math
import re
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion
from motionkit.core.shapes import Bool, Float64
from motionkit.core.skeleton import Skeleton
from motionkit.core.skeletons.mapping import with_layout_map
from motionkit.core.timegrid import parse_fps, runs
from motionkit.io import npy, source_file
from motionkit.io.body_frame import AXES, log_lines, to_y_up, upright
from motionkit.io.registry import ReadOptions

UNITS = {"mm": 0.001, "cm": 0.01, "dm": 0.1, "m": 1.0, "in": 0.0254, "inch": 0.0254, "ft": 0.3048}
# Linear interpolation over 0.1 s has an error of a·t²/8: 6 mm at 5 m/s².
MAX_GAP_SECONDS = Fraction(1, 10)
# Of C3D. Vicon's models store angles, forces and the like among the points, and list them.
NO_POSITIONS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS")
ASSUMED_UP = "z"
BLOCK = 512
KEY = 0x50
INTEL, DEC, MIPS = 84, 85, 86
MAX_FRAME_WORD = 65535
# Of TRC.
HEADER_LINES = 5
NOT_SEEN = ("", "nan")

Parameter = tuple[str, ...] | tuple[float, ...]


def largest_block(
    missing: Bool[np.ndarray, "frames markers"], max_gap: int
) -> tuple[int, int, Bool[np.ndarray, "markers"]]:
    """Frames [start, stop) and the markers in them without gaps longer than `max_gap` frames: most markers × frames.

    Markers are taken in the order of the frames that they lack in long gaps.
    """
    gone = np.zeros_like(missing)
    for marker in range(missing.shape[1]):
        for start, stop in zip(*runs(missing[:, marker]), strict=True):
            gone[start:stop, marker] = stop - start > max_gap or stop - start == len(missing)
    block, most = (0, 0, np.zeros(missing.shape[1], np.bool_)), 0
    kept, is_gone = np.zeros(missing.shape[1], np.bool_), np.zeros(len(missing), np.bool_)
    for count, marker in enumerate(np.argsort(gone.sum(axis=0), kind="stable"), start=1):
        kept[marker] = True
        is_gone |= gone[:, marker]
        starts, stops = runs(~is_gone)
        longest = int(np.argmax(stops - starts)) if len(starts) else 0
        if len(starts) and count * (stops - starts)[longest] > most:
            most = count * int((stops - starts)[longest])
            block = int(starts[longest]), int(stops[longest]), kept.copy()
    return block


@dataclass(frozen=True)
class Markers:
    """Marker names, positions in the file's unit and axes (NaN if not visible), and the operation log."""

    names: tuple[str, ...]
    positions: Float64[np.ndarray, "frames markers 3"]
    operations: tuple[str, ...]


def without_gaps(markers: Markers, fps: Fraction, path: Path) -> Markers:
    """The largest block of markers and frames without gaps longer than 0.1 s, with the shorter gaps filled.

    Gaps are filled linearly, at the ends of the take with the nearest position. Raises `FormatError` (`gaps`) if no
    marker remains.
    """
    missing = np.isnan(markers.positions[..., 0])
    start, stop, stays = largest_block(missing, int(MAX_GAP_SECONDS * fps))
    gap = f"{float(MAX_GAP_SECONDS):g} s"
    if start == stop:
        message = f"every marker has gaps longer than {gap} all the time; fill them in the capture software"
        raise FormatError(message, path=path, reason="gaps")
    operations = list(markers.operations)
    if stop - start < len(missing):
        operations.append(f"frames [{start}, {stop}) of {len(missing)} kept, throughout which most markers are seen")
    lost = [markers.names[marker] for marker in np.flatnonzero(~stays)]
    if lost:
        operations.append(f"{len(lost)} markers dropped, not seen for longer than {gap}: {some(lost)}")
    positions, missing = markers.positions[:, stays], missing[:, stays]
    kept, gone = positions[start:stop].copy(), missing[start:stop]
    longest = 0
    for marker in np.flatnonzero(gone.any(axis=0)):
        starts, stops = runs(gone[:, marker])
        longest = max(longest, int((stops - starts).max()))
        # Frames outside the block still give a marker's position on the other side of a gap.
        frames, visible = np.flatnonzero(gone[:, marker]), np.flatnonzero(~missing[:, marker])
        for axis in range(3):
            kept[frames, marker, axis] = np.interp(frames + start, visible, positions[visible, marker, axis])
    if gone.any():
        operations.append(
            f"gaps filled linearly: {int(gone.sum())} positions of {int(gone.any(axis=0).sum())} markers, the longest "
            f"{longest} frames"
        )
    return Markers(tuple(markers.names[marker] for marker in np.flatnonzero(stays)), kept, tuple(operations))


def marker_skeleton(names: tuple[str, ...]) -> Skeleton:
    """A skeleton that only names the markers: the first is the root, all others its children, with offsets of zero."""
    return Skeleton("markers", names, (-1, *([0] * (len(names) - 1))), np.zeros((len(names), 3), np.float32))


def unit_of(stated: str, name: str, unit_metres: float | None, path: Path) -> tuple[float, str]:
    """Metres per unit, as given or as the file's entry `name` states it, and why; raises `FormatError` (`unit`)."""
    if unit_metres is not None:
        return unit_metres, "given"
    if stated.lower() not in UNITS:
        message = f"{name} is {stated[:20]!r}, expected one of {', '.join(UNITS)}; or give --unit-metres"
        raise FormatError(message, path=path, reason="unit")
    return UNITS[stated.lower()], f"{name} is {stated}"


def some(names: Sequence[str]) -> str:
    """The first few names, and the number of the others."""
    return ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")


# C3D


@dataclass(frozen=True)
class C3dFile:
    """A file's `parameters` by "GROUP:NAME", and points [frames, points, 4]: x, y, z in file units, residual.

    A negative residual marks a point that is not visible.
    """

    parameters: Mapping[str, Parameter]
    points: Float64[np.ndarray, "frames points 4"]

    def texts(self, name: str) -> tuple[str, ...]:
        """A parameter's strings; empty if there are none."""
        return tuple(value for value in self.parameters.get(name, ()) if isinstance(value, str))


def read_c3d(path: Path, options: ReadOptions = ReadOptions()) -> Motion:
    """Read the markers of one file as positions in metres, y up; unlabelled ones and model outputs are left out.

    Up is the axis in POINT:Y_SCREEN, by default z, with the sign of most markers' coordinates (vendors disagree about
    the sign); the unit is POINT:UNITS, by default mm. A marker is not visible if its residual is negative, or it is NaN
    or exactly 0, 0, 0. The largest block of markers and frames without a gap longer than 0.1 s is kept; shorter gaps
    are filled linearly, at the ends of the take with the nearest position. All of this is in the operation log. Raises
    `FormatError`, with the reason `gaps` if no marker remains.
    """
    data = source_file.read_bytes(path)
    file = parse_c3d(data, path)
    rate = next(iter(numbers_of(file.parameters, "POINT:RATE")), math.nan)
    fps, log = source_file.fps_in_use(options.fps, lambda: _stated_fps(rate, "POINT:RATE", path), words=f"{rate:g}")
    markers = without_gaps(_labelled(file, path), fps, path)
    stated_unit = next(iter(file.texts("POINT:UNITS")), "")
    name = "POINT:UNITS" if stated_unit else "the usual unit"
    unit, why = unit_of(stated_unit or "mm", name, options.unit_metres, path)
    up, axis_log = (options.up, log_lines(options.up, options.up)) if options.up else _up(file, markers, path)
    positions = npy.checked_numbers(to_y_up(markers.positions, up) * unit, path)
    log += [*markers.operations, f"lengths × {unit:g} to metres ({why})", *axis_log]
    subjects = file.texts("SUBJECTS:NAMES")
    subject, skeleton = subjects[0] if len(subjects) == 1 else "", marker_skeleton(markers.names)
    return source_file.motion_of(
        path, data, "c3d", skeleton, fps, log, positions=positions, subject=subject, stated_fps=f"POINT:RATE {rate:g}"
    )


def _stated_fps(rate: float | str, name: str, path: Path) -> Fraction:
    try:
        return parse_fps(float(rate))
    except ValueError as error:
        raise FormatError(f"{name} {rate}: {error}; give --fps", path=path, reason="frame-time") from None


def _labelled(file: C3dFile, path: Path) -> Markers:
    # Labelled markers that are positions, NaN where not visible.
    num_points = file.points.shape[1]
    numbered = sorted(name for name in file.parameters if re.fullmatch(r"POINT:LABELS\d*", name))
    labels = [label for name in sorted(numbered, key=len) for label in file.texts(name)][:num_points]
    labels += [""] * (num_points - len(labels))
    other = {label for group in NO_POSITIONS for label in file.texts(f"POINT:{group}") if label}
    unlabelled = [not label or label.startswith("*") for label in labels]
    operations = []
    if all(unlabelled):
        labels, unlabelled = [f"marker_{number + 1}" for number in range(num_points)], [False] * num_points
        operations.append("markers numbered: none has a label")
    kept = [point for point in range(num_points) if not unlabelled[point] and labels[point] not in other]
    if any(unlabelled):
        operations.append(f"{sum(unlabelled)} unlabelled trajectories left out")
    modelled = [label for label in labels if label in other]
    if modelled:
        operations.append(f"no positions, left out: {some(modelled)}")
    if not kept:
        raise FormatError("no point is a labelled marker", path=path, reason="no-markers")
    names, renamed = source_file.unique_names(_without_subject([labels[point] for point in kept]))
    points = file.points[:, kept]
    positions = points[..., :3].copy()
    if np.isinf(positions).any():
        frame = int(np.nonzero(np.isinf(positions))[0][0])
        raise FormatError("infinite, expected a position", path=path, reason="range", frame=frame)
    positions[(points[..., 3] < 0) | ~positions.any(axis=-1) | np.isnan(points).any(axis=-1)] = np.nan
    return Markers(names, positions, (*operations, *renamed))


def _without_subject(labels: list[str]) -> list[str]:
    # "Anna:LFHD" → "LFHD", if all have the same subject.
    prefixes = {label.partition(":")[0] if ":" in label else "" for label in labels}
    return [label.partition(":")[2] for label in labels] if len(prefixes) == 1 and "" not in prefixes else labels


def _up(file: C3dFile, markers: Markers, path: Path) -> tuple[str, list[str]]:
    stated = next(iter(file.texts("POINT:Y_SCREEN")), "").upper()
    up = stated.lower().removeprefix("+") or ASSUMED_UP
    if up not in AXES:
        axes = ", ".join(axis.upper() if axis[0] == "-" else f"+{axis.upper()}" for axis in AXES)
        raise FormatError(f"POINT:Y_SCREEN is {stated[:20]!r}, expected one of {axes}", path=path, reason="parameters")
    why = f"POINT:Y_SCREEN is {stated}" if stated else "POINT:Y_SCREEN says nothing: z up, as is usual"
    heights = to_y_up(markers.positions, up)[..., 1]
    below = bool(np.median(heights) < 0)
    if below:
        up = up[1:] if up[0] == "-" else f"-{up}"
        why += ", but that way most markers would be below the floor"
    return up, [] if up == "y" and not below else [f"turned from {up.replace('-', '−')} up to y up ({why})"]


def parse_c3d(data: bytes, path: Path) -> C3dFile:
    """Read a whole file; raises `FormatError` (`not-what-it-says`, `truncated`, `parameters`, `no-frames` …)."""
    if len(data) < 2 or data[1] != KEY:
        message = f"looks like {source_file.describe_content(data)}, expected a C3D file"
        raise FormatError(message, path=path, reason="not-what-it-says")
    start = (data[0] - 1) * BLOCK
    if not BLOCK <= start < len(data) - 3:
        message = f"the parameters begin at byte {start}, but the file has {len(data)}"
        raise FormatError(message, path=path, reason="truncated")
    num_blocks, processor = data[start + 2], data[start + 3]
    if processor not in (INTEL, DEC, MIPS):
        message = f"processor type {processor}, expected {INTEL} (Intel), {DEC} (DEC) or {MIPS} (MIPS)"
        raise FormatError(message, path=path, reason="parameters")
    parameters = _parameters(data[start + 4 : start + max(num_blocks, 1) * BLOCK], processor, path)
    if not numbers_of(parameters, "POINT:RATE"):
        parameters["POINT:RATE"] = tuple(_floats(data[20:24], processor).tolist())
    return C3dFile(parameters, _points(data, parameters, processor, path))


def _floats(data: bytes, processor: int) -> Float64[np.ndarray, "numbers"]:
    with np.errstate(invalid="ignore"):  # signalling NaN, in bytes that are not floats
        if processor != DEC:
            return np.frombuffer(data, ">f4" if processor == MIPS else "<f4").astype(np.float64)
        # VAX F: the 16-bit words are swapped, and the exponent's bias is larger by two.
        words = np.ascontiguousarray(np.frombuffer(data, "<u2").reshape(-1, 2)[:, ::-1])
        return words.view("<f4")[:, 0].astype(np.float64) / 4.0


def _parameters(data: bytes, processor: int, path: Path) -> dict[str, Parameter]:
    """Records of groups (negative number) and of their parameters, in any order; each has the offset to the next."""
    groups: dict[int, str] = {}
    values: list[tuple[int, str, Parameter]] = []
    at = 0
    while at + 2 <= len(data):
        name_length, number = struct.unpack_from("bb", data, at)
        if name_length == 0 or number == 0:
            break
        name_end = at + 2 + abs(name_length)
        name = data[at + 2 : name_end].decode("latin-1").strip().upper()
        if name_end + 2 > len(data):
            raise _cut_off(path)
        (step,) = struct.unpack_from(">h" if processor == MIPS else "<h", data, name_end)
        if number < 0:
            groups[-number] = name
        else:
            values.append((number, name, _value(data[name_end + 2 :], processor, path)))
        if step <= 0:
            break
        at = name_end + step
    return {f"{groups[number]}:{name}": value for number, name, value in values if number in groups}


def _value(data: bytes, processor: int, path: Path) -> Parameter:
    """A parameter of any number of dimensions, flat; of strings the first dimension is their length."""
    if len(data) < 2 or len(data) < 2 + data[1]:
        raise _cut_off(path)
    kind, num_dimensions = struct.unpack_from("bB", data)
    dimensions = tuple(data[2 : 2 + num_dimensions])
    if kind not in (-1, 1, 2, 4):
        raise FormatError(f"a parameter of type {kind}, expected -1, 1, 2 or 4", path=path, reason="parameters")
    num_bytes = math.prod(dimensions) * abs(kind)
    body = data[2 + num_dimensions : 2 + num_dimensions + num_bytes]
    if len(body) < num_bytes:
        raise _cut_off(path)
    if kind == -1:
        length = max(dimensions[0], 1) if dimensions else 1
        return tuple(body[i : i + length].decode("latin-1").strip("\0 ") for i in range(0, len(body), length))
    if kind == 4:
        return tuple(_floats(body, processor).tolist())
    code = "b" if kind == 1 else ">i2" if processor == MIPS else "<i2"
    return tuple(float(value) for value in np.frombuffer(body, code).tolist())


def _cut_off(path: Path) -> FormatError:
    return FormatError("the parameters end in the middle of one", path=path, reason="truncated")


def numbers_of(parameters: Mapping[str, Parameter], name: str) -> tuple[float, ...]:
    """A parameter's finite numbers; empty if there are none."""
    return tuple(each for each in parameters.get(name, ()) if not isinstance(each, str) and np.isfinite(each))


def _points(
    data: bytes, parameters: Mapping[str, Parameter], processor: int, path: Path
) -> Float64[np.ndarray, "frames points 4"]:
    order = ">" if processor == MIPS else "<"
    num_points, num_analog, first_frame, last_frame = struct.unpack_from(f"{order}4H", data, 2)
    num_frames = _num_frames(first_frame, last_frame, parameters)
    if num_frames < 1:
        raise FormatError("0 frames, expected at least one", path=path, reason="no-frames")
    if num_points < 1:
        raise FormatError("0 points, expected markers", path=path, reason="no-markers")
    scale = next(iter(numbers_of(parameters, "POINT:SCALE")), float(_floats(data[12:16], processor)[0]))
    if not np.isfinite(scale) or scale == 0:
        raise FormatError(f"POINT:SCALE is {scale}, expected a number", path=path, reason="parameters")
    size = 4 if scale < 0 else 2
    num_values = 4 * num_points + num_analog
    start = (struct.unpack_from(f"{order}H", data, 16)[0] - 1) * BLOCK
    needed, available = num_frames * num_values * size, len(data) - start
    if start < BLOCK or available < needed:
        message = f"{num_frames} frames of {num_points} points need {needed} bytes from byte {start} of {len(data)}"
        raise FormatError(message, path=path, reason="truncated")
    if num_frames == MAX_FRAME_WORD and available > needed + BLOCK:
        message = "more than the 65,535 frames that a header can state: state them in TRIAL:ACTUAL_END_FIELD"
        raise FormatError(message, path=path, reason="frame-count")
    # Analog values follow the points of each frame, and are often most of a file.
    values = np.frombuffer(data, f"<u{size}", num_frames * num_values, start).reshape(num_frames, num_values)
    body, shape = values[:, : 4 * num_points].tobytes(), (num_frames, num_points, 4)
    if size == 4:
        return _floats(body, processor).reshape(shape)
    points = np.frombuffer(body, f"{order}i2").reshape(shape).astype(np.float64)
    points[..., :3] *= scale
    return points


def _num_frames(first_frame: int, last_frame: int, parameters: Mapping[str, Parameter]) -> int:
    """The header's words hold frames up to 65,535; longer takes state them in parameters, as two words or a number."""
    start, end = (numbers_of(parameters, f"TRIAL:ACTUAL_{name}_FIELD") for name in ("START", "END"))
    if len(start) == len(end) == 2:
        first, last = (int(low) % 65536 + 65536 * (int(high) % 65536) for low, high in (start, end))
        return last - first + 1
    stated = last_frame - first_frame + 1
    if last_frame < MAX_FRAME_WORD:
        return stated
    return int(max(stated, *numbers_of(parameters, "POINT:LONG_FRAMES"), *numbers_of(parameters, "POINT:FRAMES")))


# TRC


def read_trc(path: Path, options: ReadOptions = ReadOptions()) -> Motion:
    """Read one table as positions in metres, y up, with gaps treated as in C3D; raises `FormatError`.

    If the markers are joints by their names, up is inferred from the body (`body_frame.infer_up`: y, z or −y); else it
    is y, as in OpenSim.
    """
    data = source_file.read_bytes(path)
    lines = source_file.decode(data, path).splitlines()
    # Spreadsheets write commas: between columns, or in numbers where tabs are between them.
    has_tabs = "\t" in "".join(lines[3:4])
    mark = "." if has_tabs else "\t"
    lines = [line.replace(",", mark) if number != 3 or not has_tabs else line for number, line in enumerate(lines)]
    stated, names = _header(lines, path)
    table = _table(lines, 2 + 3 * len(names), path)
    if stated.get("NumFrames", "") not in ("", str(len(table))):
        message = f"the file ends after {len(table)} frames, expected {stated['NumFrames'][:20]}"
        raise FormatError(message, path=path, reason="truncated", line=len(lines), frame=len(table))
    rate = stated.get("DataRate", "")

    def stated_fps() -> Fraction:
        return source_file.grid_of_seconds(table[:, 1], path, _stated_fps(rate, "DataRate", path)).fps

    fps, log = source_file.fps_in_use(options.fps, stated_fps, words=rate[:20])
    points = table[:, 2:].reshape(len(table), len(names), 3)
    points[~points.any(axis=-1) | np.isnan(points).any(axis=-1)] = np.nan
    unique, renamed = source_file.unique_names(names)
    markers = without_gaps(Markers(unique, points, renamed), fps, path)
    unit, why = unit_of(stated.get("Units", ""), "Units", options.unit_metres, path)
    positions = npy.checked_numbers(markers.positions * unit, path)
    skeleton = with_layout_map(marker_skeleton(markers.names), options.skeleton_maps)
    positions, turned = upright(skeleton, positions, options.up)
    log += [*markers.operations, f"lengths × {unit:g} to metres ({why})", *turned]
    return source_file.motion_of(path, data, "trc", skeleton, fps, log, positions=positions, stated_fps=rate[:20])


def _header(lines: list[str], path: Path) -> tuple[dict[str, str], list[str]]:
    """The header's values by name, and the markers' names."""
    if len(lines) < HEADER_LINES or not lines[0].startswith("PathFileType"):
        message = f"{HEADER_LINES} lines of header were expected, the first of them PathFileType"
        raise FormatError(message, path=path, reason="not-what-it-says", line=1)
    keys, values = ([word.strip() for word in line.split("\t")] for line in lines[1:3])
    stated = dict(zip(keys, values, strict=False))
    cells = [word.strip() for word in lines[3].rstrip().split("\t")]
    names = [name for name in cells[2:] if name]
    if cells[0] != "Frame#" or not names or stated.get("NumMarkers", "") not in ("", str(len(names))):
        message = f"{len(names)} markers after Frame# and Time, expected {stated.get('NumMarkers', 'some')[:20]}"
        raise FormatError(message, path=path, reason="channel-count", line=4)
    return stated, names


def _table(lines: list[str], num_columns: int, path: Path) -> Float64[np.ndarray, "frames columns"]:
    rows: list[list[float]] = []
    for number, line in enumerate(lines[HEADER_LINES:], start=HEADER_LINES + 1):
        if not line.strip():
            continue
        cells = line.split("\t")
        if len(cells) < num_columns or any(cell.strip() for cell in cells[num_columns:]):
            message = f"{len(cells)} values between tabs, expected {num_columns}"
            raise FormatError(message, path=path, reason="channel-count", line=number, frame=len(rows))
        row: list[float] = []
        for word in (cell.strip() for cell in cells[:num_columns]):
            is_seen = word.lower() not in NOT_SEEN
            row.append(source_file.parse_number(word, path, number, len(rows)) if is_seen else np.nan)
        rows.append(row)
    if not rows:
        raise FormatError("0 frames, expected at least one row below the header", path=path, reason="no-frames")
    return np.array(rows)
