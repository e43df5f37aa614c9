"""The store's file formats: Arrow schemas, sizes, resolution, Parquet options.

Numbers are measured choices (docs/store.md): zstd with BYTE_STREAM_SPLIT on channel-major float lists is the smallest
that still decodes at memory speed; dictionaries make float columns larger; the row group is pyarrow's unit of access,
so a small one makes single reads quick, and 16 segments cost 0.5 % of size against 256.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from motionkit.core.files import MANIFEST_FILE as MANIFEST_FILE
from motionkit.core.files import SEGMENTS_FOLDER as SEGMENTS_FOLDER
from motionkit.core.files import SEQUENCES_FILE as SEQUENCES_FILE
from motionkit.core.shapes import Float32

# 2^-22: 0.24 micrometres, or half a microradian of a quaternion's turn. It is the spacing of float32 itself from 2 to
# 4 metres from the origin, so no coordinate loses what it would have kept a few steps further away.
RESOLUTION_BITS = 22
_SCALE = np.float32(2.0**RESOLUTION_BITS)
# What this times the scale would be beyond float32; far from all bodies.
_TOO_LARGE = np.float32(2.0**100)


def rounded(values: Float32[np.ndarray, "*shape"]) -> Float32[np.ndarray, "*shape"]:
    """Rounds to the nearest multiple of 2^-22, ties to even; from 2 on float32 has no finer resolution."""
    if not values.size or not (values.min() > -_TOO_LARGE and values.max() < _TOO_LARGE):
        inside = np.where(np.abs(values) < _TOO_LARGE, values, np.float32(0))
        return np.where(inside == values, rounded(inside), values) if values.size else values
    # Scaling by a power of two is exact, and from 2 on the scaled number is whole.
    on_grid: Float32[np.ndarray, "*shape"] = values * _SCALE
    np.rint(on_grid, out=on_grid)
    on_grid /= _SCALE
    return on_grid


FORMAT_NAME = "motionkit-store"
FORMAT_VERSION = 2

SEGMENT_FRAMES = 256
# So many segments of a sequence come together, and lie in one row group.
RUN_SEGMENTS = 16
ROW_GROUP_SEGMENTS = 16
PART_BYTES = 128 * 2**20
# More than a column of a row group has: one page for each.
PAGE_BYTES = 8 * 2**20
SEQUENCES_PER_ROW_GROUP = 4096

SKELETONS_FILE = "skeletons.parquet"
CACHE_FOLDER = "cache"

# Bytes of one frame of one joint as raw float32: what sizes on disk are compared with.
POSITION_BYTES_PER_JOINT = 3 * 4
ROTATION_BYTES_PER_JOINT = 4 * 4
ROOT_TRANSLATION_BYTES = 3 * 4


def _required(name: str, kind: Any) -> pa.Field:
    return pa.field(name, kind, nullable=False)


FLOAT_LIST = pa.large_list(_required("element", pa.float32()))

CAPTION = pa.struct(
    [
        _required("text", pa.string()),
        _required("start_seconds", pa.float64()),
        pa.field("end_seconds", pa.float64()),
        _required("tokens", pa.string()),
    ]
)

# start_seconds, seconds_between_frames and duration_seconds are the grid (t0, dt, l_max); part, first_row and
# num_segments say where the frames lie.
SEQUENCES = pa.schema(
    [
        _required("sequence_index", pa.int32()),
        _required("sequence_id", pa.string()),
        _required("fps_numerator", pa.int64()),
        _required("fps_denominator", pa.int64()),
        _required("fps", pa.float64()),
        _required("stated_fps", pa.string()),
        _required("num_frames", pa.int32()),
        _required("duration_seconds", pa.float64()),
        _required("start_seconds", pa.float64()),
        _required("seconds_between_frames", pa.float64()),
        _required("skeleton", pa.string()),
        _required("num_joints", pa.int16()),
        _required("has_rotations", pa.bool_()),
        _required("has_root_translation", pa.bool_()),
        _required("source", pa.string()),
        _required("subset", pa.string()),
        _required("licence", pa.string()),
        _required("subject", pa.string()),
        _required("split", pa.string()),
        _required("action", pa.string()),
        _required("style", pa.string()),
        _required("captions", pa.list_(_required("element", CAPTION))),
        _required("source_path", pa.string()),
        _required("source_sha256", pa.string()),
        _required("source_format", pa.string()),
        _required("max_joint_speed_metres_per_second", pa.float64()),
        _required("floor_height_metres", pa.float64()),
        pa.field("num_teleports", pa.int32()),
        pa.field("first_teleport_seconds", pa.float64()),
        pa.field("jitter_metres_per_second_cubed", pa.float64()),
        pa.field("frozen_seconds", pa.float64()),
        pa.field("frozen_start_seconds", pa.float64()),
        pa.field("held_share", pa.float64()),
        pa.field("foot_skate_metres_per_second", pa.float64()),
        pa.field("foot_skate_share", pa.float64()),
        pa.field("bone_length_drift", pa.float64()),
        pa.field("effective_fps", pa.float64()),
        _required("quality_flags", pa.list_(_required("element", pa.string()))),
        _required("operations", pa.list_(_required("element", pa.string()))),
        _required("part", pa.int32()),
        _required("first_row", pa.int32()),
        _required("num_segments", pa.int32()),
    ]
)


def _floats(name: str, unit: str, *, nullable: bool) -> pa.Field:
    metadata = {"unit": unit, "resolution": f"2^-{RESOLUTION_BITS}"}
    return pa.field(name, FLOAT_LIST, nullable=nullable, metadata=metadata)


# Where a sequence lies in its store: what changes when it is copied into another one.
PLACE_COLUMNS = ("sequence_index", "part", "first_row")

# Float lists are channel-major inside a segment: all frames of channel 0, then of channel 1 …; channel = 3·joint + axis
# for positions, 4·joint + component (w, x, y, z) for rotations, the axis for the root's translation.
SEGMENTS = pa.schema(
    [
        _required("sequence_index", pa.int32()),
        _required("start_frame", pa.int32()),
        _required("num_frames", pa.int16()),
        _floats("joint_positions", "metre", nullable=False),
        _floats("joint_rotations", "unit quaternion", nullable=True),
        _floats("root_translation", "metre", nullable=True),
    ]
)
KEY_COLUMNS = ("sequence_index", "start_frame", "num_frames")
FLOAT_COLUMNS = ("joint_positions", "joint_rotations", "root_translation")

SKELETONS = pa.schema(
    [
        _required("skeleton", pa.string()),
        _required("name", pa.string()),
        _required("joint_names", pa.list_(_required("element", pa.string()))),
        _required("parents", pa.list_(_required("element", pa.int32()))),
        _required("offsets", pa.list_(_required("element", pa.float32()))),
        _required(
            "left_right_pairs",
            pa.list_(_required("element", pa.struct([_required("left", pa.int32()), _required("right", pa.int32())]))),
        ),
        pa.field(
            "feet",
            pa.struct([_required(name, pa.int32()) for name in ("left_ankle", "left_toe", "right_ankle", "right_toe")]),
        ),
        _required(
            "end_sites",
            pa.list_(
                _required(
                    "element",
                    pa.struct(
                        [_required("joint", pa.int32()), *(_required(axis, pa.float64()) for axis in ("x", "y", "z"))]
                    ),
                )
            ),
        ),
        _required("layout_map", pa.string()),
    ]
)


def part_name(number: int) -> str:
    """Path of a part inside the store: `segments/part-00007.parquet`."""
    return f"{SEGMENTS_FOLDER}/part-{number:05d}.parquet"


def part_number(name: str) -> int:
    """The number in a part's path."""
    return int(Path(name).stem.removeprefix("part-"))


def part_writer_options() -> dict[str, Any]:
    """Keyword arguments of `pyarrow.parquet.ParquetWriter` for parts: each page has a CRC-32."""
    return {
        "compression": "zstd",
        "compression_level": 3,
        "use_dictionary": False,
        "use_byte_stream_split": [f"{name}.list.element" for name in FLOAT_COLUMNS],
        "write_statistics": list(KEY_COLUMNS),
        "data_page_size": PAGE_BYTES,
        "write_page_checksum": True,
    }


def table_writer_options() -> dict[str, Any]:
    """Keyword arguments of `pyarrow.parquet.ParquetWriter` for sequences and skeletons."""
    return {"compression": "zstd", "compression_level": 3}
