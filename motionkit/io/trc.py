"""TRC: tracks of markers, or of joints from markerless systems, as OpenSim's text table.

Five header lines (file, names of the values, the values, names of the markers, axes), then one row per frame: number,
time, x, y, z of every marker, separated by tabs; empty cells, NaN and 0, 0, 0 are markers not visible. Source:
OpenSim's user's guide, "Marker (.trc) Files"; https://github.com/perfanalytics/pose2sim writes them.
"""

from fractions import Fraction
from pathlib import Path

import numpy as np

from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float64
from motionkit.core.skeletons.mapping import with_layout_map
from motionkit.core.timegrid import TimeGrid, parse_fps
from motionkit.io import source_file
from motionkit.io.body_frame import upright
from motionkit.io.markers import Markers, checked_metres, marker_skeleton, unit_of, without_gaps
from motionkit.io.registry import Format, ReadOptions, of_path

HEADER_LINES = 5
NOT_SEEN = ("", "nan")


def read_trc(path: Path, options: ReadOptions | None = None) -> Motion:
    """Read one table as positions in metres, y up, with gaps treated as in `io.c3d`; raises `FormatError`.

    If the markers are joints by their names, up is inferred from the body (`body_frame.infer_up`: y, z or −y); else it
    is y, as in OpenSim.
    """
    options = options or ReadOptions()
    data = source_file.read_bytes(path)
    lines = source_file.decode(data, path).splitlines()
    stated, names = _header(lines, path)
    table = _table(lines, 2 + 3 * len(names), path)
    if stated.get("NumFrames", "") not in ("", str(len(table))):
        message = f"the file ends after {len(table)} frames, expected {stated['NumFrames'][:20]}"
        raise FormatError(message, path=path, reason="truncated", line=len(lines), frame=len(table))
    rate = stated.get("DataRate", "")
    fps, log = source_file.fps_in_use(options.fps, lambda: _stated_fps(rate, table[:, 1], path), words=rate[:20])
    points = table[:, 2:].reshape(len(table), len(names), 3)
    points[~points.any(axis=-1) | np.isnan(points).any(axis=-1)] = np.nan
    unique, renamed = source_file.unique_names(names)
    markers = without_gaps(Markers(unique, points, renamed), fps, path)
    unit, why = unit_of(stated.get("Units", ""), "Units", options.unit_metres, path)
    positions = checked_metres(markers, markers.positions * unit, path)
    skeleton = with_layout_map(marker_skeleton(markers.names), options.skeleton_maps)
    positions, turned = upright(skeleton, positions, options.up)
    log += [*markers.operations, f"lengths × {unit:g} to metres ({why})", *turned]
    return Motion(
        positions,
        skeleton,
        TimeGrid(fps, len(positions)),
        sequence_id=path.stem,
        provenance=source_file.provenance(path, data, "trc", log, stated_fps=rate[:20]),
    )


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


def _stated_fps(rate: str, seconds: Float64[np.ndarray, "frames"], path: Path) -> Fraction:
    try:
        fps = parse_fps(float(rate))
    except ValueError as error:
        raise FormatError(f"DataRate: {error}; give --fps", path=path, reason="frame-time", line=3) from None
    return source_file.grid_of_seconds(seconds, path, fps).fps


FORMAT = Format(name="trc", read=of_path(read_trc), suffixes=(".trc",), turns_up=True)
