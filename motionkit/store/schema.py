"""The store's tables: Arrow schemas, and motions and skeletons as their rows.

`sequences.parquet` has a row of scalars for each sequence, `motions/part-*.parquet` a row with its frames,
`skeletons.parquet` a row for each skeleton. Numbers are measured choices (docs/store.md): zstd with BYTE_STREAM_SPLIT
on channel-major lists is the smallest layout that still decodes at memory speed; dictionaries make it larger.
"""

import sys
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from motionkit.core.errors import StoreError
from motionkit.core.files import MOTIONS_FOLDER
from motionkit.core.motion import Caption, Motion, Provenance
from motionkit.core.shapes import Float32
from motionkit.core.skeleton import Feet, Skeleton
from motionkit.core.timegrid import TimeGrid
from motionkit.features.quality import measure

Row = dict[str, Any]

SKELETONS_FILE = "skeletons.parquet"
CACHE_FOLDER = "cache"

# A row group is what Parquet decodes at once: it ends with the sequence that brings it to so many frames, and a longer
# sequence has one of its own.
ROW_GROUP_FRAMES = 2048
PART_BYTES = 128 * 2**20
# Larger than a column of most row groups, which then is one page.
PAGE_BYTES = 8 * 2**20
SEQUENCES_PER_ROW_GROUP = 4096
# The offsets of a list are 32 bits wide.
MAX_VALUES = 2**31 - 1

# 2^-22: 0.24 micrometres, or half a microradian of a quaternion's turn. It is the spacing of float32 itself from 2 to
# 4 metres from the origin, so no coordinate loses what it would have kept a few steps further away.
RESOLUTION_BITS = 22
_SCALE = np.float32(2.0**RESOLUTION_BITS)


def rounded(values: Float32[np.ndarray, "*shape"]) -> Float32[np.ndarray, "*shape"]:
    """Round to the nearest multiple of 2^-22, ties to even; from 2 on float32 has no finer resolution."""
    # Scaling by a power of two is exact.
    small = np.rint(np.clip(values, -2.0, 2.0) * _SCALE) / _SCALE
    return np.where(np.abs(values) < 2.0, small, values)


def _field(name: str, kind: Any) -> pa.Field:
    return pa.field(name, kind, nullable=False)


def _list(kind: Any) -> Any:
    return pa.list_(_field("element", kind))


# start_seconds, seconds_between_frames and duration_seconds are the grid (t0, dt, l_max); part and part_row say where
# the frames lie: which part, which of its rows.
SEQUENCES = pa.schema(
    [
        _field("sequence_index", pa.int32()),
        _field("sequence_id", pa.string()),
        _field("fps_numerator", pa.int64()),
        _field("fps_denominator", pa.int64()),
        _field("fps", pa.float64()),
        _field("stated_fps", pa.string()),
        _field("num_frames", pa.int32()),
        _field("duration_seconds", pa.float64()),
        _field("start_seconds", pa.float64()),
        _field("seconds_between_frames", pa.float64()),
        _field("skeleton", pa.string()),
        _field("num_joints", pa.int16()),
        _field("has_rotations", pa.bool_()),
        _field("has_root_translation", pa.bool_()),
        _field("source", pa.string()),
        _field("subset", pa.string()),
        _field("licence", pa.string()),
        _field("subject", pa.string()),
        _field("split", pa.string()),
        _field("action", pa.string()),
        _field("style", pa.string()),
        _field(
            "captions",
            _list(
                pa.struct(
                    [
                        _field("text", pa.string()),
                        _field("start_seconds", pa.float64()),
                        pa.field("end_seconds", pa.float64()),
                        _field("tokens", pa.string()),
                    ]
                )
            ),
        ),
        _field("source_path", pa.string()),
        _field("source_sha256", pa.string()),
        _field("source_format", pa.string()),
        _field("max_joint_speed_metres_per_second", pa.float64()),
        _field("floor_height_metres", pa.float64()),
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
        _field("quality_flags", _list(pa.string())),
        _field("operations", _list(pa.string())),
        _field("part", pa.int32()),
        _field("part_row", pa.int32()),
    ]
)

# A motion's arrays, each a list of all frames of channel 0, then of channel 1 …: channel 3·joint + axis of positions,
# 4·joint + component (w, x, y, z) of rotations, the axis of the root's translation.
FRAME_COLUMNS = ("joint_positions", "local_rotations", "root_translation")
FLOAT_LIST = _list(pa.float32())
MOTIONS = pa.schema(
    [
        _field("sequence_index", pa.int32()),
        _field("sequence_id", pa.string()),
        _field("num_frames", pa.int32()),
        _field("num_joints", pa.int16()),
        *(
            pa.field(
                name,
                FLOAT_LIST,
                nullable=name != "joint_positions",
                metadata={"unit": unit, "resolution": f"2^-{RESOLUTION_BITS}"},
            )
            for name, unit in zip(FRAME_COLUMNS, ("metre", "unit quaternion", "metre"), strict=True)
        ),
    ]
)
KEY_COLUMNS = ("sequence_index", "sequence_id", "num_frames", "num_joints")

# Options of pyarrow.parquet.ParquetWriter for sequences and skeletons, and for parts.
TABLE_OPTIONS: Row = {"compression": "zstd", "compression_level": 3}
PART_OPTIONS: Row = {
    **TABLE_OPTIONS,
    "use_dictionary": False,
    "use_byte_stream_split": [f"{name}.list.element" for name in FRAME_COLUMNS],
    "write_statistics": list(KEY_COLUMNS),
    "data_page_size": PAGE_BYTES,
}

SKELETONS = pa.schema(
    [
        _field("skeleton", pa.string()),
        _field("name", pa.string()),
        _field("joint_names", _list(pa.string())),
        _field("parents", _list(pa.int32())),
        _field("offsets", _list(pa.float32())),
        _field("left_right_pairs", _list(pa.struct([_field("left", pa.int32()), _field("right", pa.int32())]))),
        pa.field("feet", pa.struct([_field(each.name, pa.int32()) for each in fields(Feet)])),
        _field(
            "end_sites",
            _list(pa.struct([_field("joint", pa.int32()), *(_field(axis, pa.float64()) for axis in ("x", "y", "z"))])),
        ),
        _field("layout_map", pa.string()),
    ]
)


def part_name(number: int) -> str:
    """Path of a part inside the store: `motions/part-00007.parquet`."""
    return f"{MOTIONS_FOLDER}/part-{number:05d}.parquet"


def part_number(name: str) -> int:
    """The number in a part's path."""
    return int(Path(name).stem.removeprefix("part-"))


class RefusedMotion(StoreError):
    """A motion that cannot be stored; `reason` is a fixed slug.

    `duplicate-id`, `nan`, `no-id`, `frame-time`, `not-unicode`, `too-long`.
    """

    def __init__(self, message: str, *, reason: str) -> None:
        super().__init__(message)
        self.reason = reason


@dataclass(frozen=True, eq=False)
class EncodedMotion:
    """A motion as rows: `row` of SEQUENCES without its index and place, `frames` of MOTIONS without its index."""

    row: Row
    skeleton: Skeleton
    frames: pa.RecordBatch


def encode(motion: Motion) -> EncodedMotion:
    """Check a motion, round it to 2^-22 and encode it; raises `RefusedMotion` for one that cannot be stored."""
    _check(motion)
    motion = replace(motion, joint_positions=rounded(motion.joint_positions))  # measure what is stored
    quality = measure(motion)
    row = {
        "sequence_id": motion.sequence_id,
        "fps_numerator": motion.fps.numerator,
        "fps_denominator": motion.fps.denominator,
        "fps": float(motion.fps),
        "num_frames": motion.num_frames,
        "duration_seconds": motion.duration_seconds,
        "start_seconds": motion.timegrid.start_seconds,
        "seconds_between_frames": motion.timegrid.seconds_between_frames,
        "skeleton": motion.skeleton.fingerprint,
        "num_joints": motion.skeleton.num_joints,
        "has_rotations": motion.local_rotations is not None,
        "has_root_translation": motion.root_translation is not None,
        "split": motion.split,
        "action": motion.action,
        "style": motion.style,
        "captions": list(map(vars, motion.captions)),
        **vars(motion.provenance),
        **{name: value for name, value in vars(quality).items() if name != "flags"},
        "quality_flags": list(quality.flags),
    }
    keys = [
        pa.array([motion.sequence_id], pa.string()),
        pa.array([motion.num_frames], pa.int32()),
        pa.array([motion.skeleton.num_joints], pa.int16()),
    ]
    rotations, root = (
        None if array is None else rounded(array) for array in (motion.local_rotations, motion.root_translation)
    )
    lists = map(_channel_major, (motion.joint_positions, rotations, root))
    return EncodedMotion(row, motion.skeleton, pa.RecordBatch.from_arrays([*keys, *lists], schema=MOTIONS.remove(0)))


def _channel_major(frames: Float32[np.ndarray, "frames *channels"] | None) -> pa.Array:
    """One list of all frames of channel 0, then of channel 1 …; or null."""
    if frames is None:
        return pa.nulls(1, FLOAT_LIST)
    values = np.ascontiguousarray(frames.reshape(len(frames), -1).T).ravel()
    return pa.ListArray.from_arrays(pa.array([0, values.size], pa.int32()), pa.array(values), type=FLOAT_LIST)


def _check(motion: Motion) -> None:
    if not motion.sequence_id:
        raise RefusedMotion("a motion needs a sequence_id to be stored", reason="no-id")
    provenance = motion.provenance
    texts = [motion.sequence_id, motion.action, motion.style, motion.split, *provenance.operations]
    texts += [value for value in vars(provenance).values() if isinstance(value, str)]
    texts += [text for caption in motion.captions for text in (caption.text, caption.tokens)]
    try:
        "".join(texts).encode()
    except UnicodeEncodeError:  # file names may not be valid Unicode
        encoding = sys.getfilesystemencoding()
        hint = "rename the file" if encoding == "utf-8" else f"names are read as {encoding} here, set PYTHONUTF8=1"
        raise RefusedMotion(
            f"{motion.sequence_id!a}: a name or a text is not valid Unicode: {hint}", reason="not-unicode"
        ) from None
    if max(motion.fps.numerator, motion.fps.denominator) >= 2**63:
        raise RefusedMotion(f"the framerate {float(motion.fps):g} has too long a fraction", reason="frame-time")
    for name in FRAME_COLUMNS:
        array = getattr(motion, name)
        if array is None:
            continue
        if array.size > MAX_VALUES:
            seconds = motion.duration_seconds * MAX_VALUES / array.size
            raise RefusedMotion(
                f"{motion.sequence_id}: {name} are {array.size:,} numbers, more than the {MAX_VALUES:,} of a row: "
                f"cut it, in Python mk.read(FILE)[:{seconds:.0f}].save('first.npz')",
                reason="too-long",
            )
        if not np.isfinite(array).all():
            frame = int(np.nonzero(~np.isfinite(array.reshape(len(array), -1)).all(axis=1))[0][0])
            raise RefusedMotion(
                f"{motion.sequence_id}: {name} are not finite from frame {frame} on: repair or cut it", reason="nan"
            )


def motion_from_row(
    row: Mapping[str, Any], skeleton: Skeleton, frames: Mapping[str, Float32[np.ndarray, "frames *channels"]]
) -> Motion:
    """The motion of a row of SEQUENCES; `frames` are the arrays that it has, by the names of FRAME_COLUMNS."""
    texts = {each.name: row[each.name] for each in fields(Provenance) if each.name != "operations"}
    return Motion(
        joint_positions=frames["joint_positions"],
        skeleton=skeleton,
        timegrid=TimeGrid(
            Fraction(row["fps_numerator"], row["fps_denominator"]), row["num_frames"], row["start_seconds"]
        ),
        local_rotations=frames.get("local_rotations"),
        root_translation=frames.get("root_translation"),
        captions=tuple(Caption(**caption) for caption in row["captions"]),
        action=row["action"],
        style=row["style"],
        split=row["split"],
        sequence_id=row["sequence_id"],
        provenance=Provenance(**texts, operations=tuple(row["operations"])),
    )


def frame_shapes(row: Mapping[str, Any], *, rotations: bool = True) -> dict[str, tuple[int, ...]]:
    """Shapes of one frame of the arrays that a sequence has, by column; of the positions alone without `rotations`."""
    shapes: dict[str, tuple[int, ...]] = {"joint_positions": (row["num_joints"], 3)}
    if rotations and row["has_rotations"]:
        shapes["local_rotations"] = (row["num_joints"], 4)
    if rotations and row["has_root_translation"]:
        shapes["root_translation"] = (3,)
    return shapes


def skeleton_row(skeleton: Skeleton) -> Row:
    """A skeleton's row in the table of skeletons; `offsets` are flat [J·3]."""
    return {
        "skeleton": skeleton.fingerprint,
        "name": skeleton.name,
        "joint_names": list(skeleton.joint_names),
        "parents": list(skeleton.parents),
        "offsets": skeleton.offsets.astype(np.float32).ravel().tolist(),
        "left_right_pairs": [{"left": left, "right": right} for left, right in skeleton.left_right_pairs],
        "feet": None if skeleton.feet is None else vars(skeleton.feet),
        "end_sites": [{"joint": joint, "x": x, "y": y, "z": z} for joint, (x, y, z) in skeleton.end_sites],
        "layout_map": skeleton.layout_map,
    }


def skeleton_from_row(row: Mapping[str, Any]) -> Skeleton:
    """Rebuild the skeleton that `skeleton_row` described; raises `ValueError` for what is none."""
    num_joints = len(row["joint_names"])
    skeleton = Skeleton(
        name=row["name"],
        joint_names=tuple(row["joint_names"]),
        parents=tuple(row["parents"]),
        offsets=np.array(row["offsets"], dtype=np.float32).reshape(num_joints, 3),
        left_right_pairs=tuple((pair["left"], pair["right"]) for pair in row["left_right_pairs"]),
        feet=None if row["feet"] is None else Feet(**row["feet"]),
        end_sites=tuple((site["joint"], (site["x"], site["y"], site["z"])) for site in row["end_sites"]),
        layout_map=row["layout_map"],
    )
    joints = [joint for joint, _ in skeleton.end_sites]
    joints += [joint for pair in skeleton.left_right_pairs for joint in pair]
    joints += [] if skeleton.feet is None else vars(skeleton.feet).values()
    if not all(0 <= joint < num_joints for joint in joints):
        raise ValueError(f"feet, pairs or end sites name a joint that is none of its {num_joints}")
    tips = [coordinate for _, offset in skeleton.end_sites for coordinate in offset]
    if not (np.isfinite(skeleton.offsets).all() and np.isfinite(tips).all()):
        raise ValueError("its offsets are not finite")
    return skeleton


# LaFAN1's sequences state one body's lengths as 43.500000 and 43.499996 cm.
_SAME_METRES = 1e-5


def same_body(skeleton: Skeleton) -> tuple[object, ...]:
    """A key that skeletons share which differ by their name, and by rounding of their lengths at most."""
    lengths = [*skeleton.offsets.ravel().tolist(), *(x for _, offset in skeleton.end_sites for x in offset)]
    return (
        skeleton.joint_names,
        skeleton.parents,
        skeleton.left_right_pairs,
        skeleton.feet,
        tuple(joint for joint, _ in skeleton.end_sites),
        skeleton.layout_map,
        tuple(np.round(np.array(lengths) / _SAME_METRES).astype(np.int64).tolist()),
    )
