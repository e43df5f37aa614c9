"""Motions and skeletons ↔ rows of the store's tables and segments of its parts, column by column."""

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
import pyarrow as pa

from motionkit.core.errors import StoreError
from motionkit.core.motion import Caption, Motion, Provenance
from motionkit.core.shapes import Float32, Shaped
from motionkit.core.skeleton import Feet, Skeleton
from motionkit.core.timegrid import TimeGrid
from motionkit.features.quality import measure
from motionkit.store import codec
from motionkit.store.schema import FLOAT_LIST, RUN_SEGMENTS, SEGMENT_FRAMES, SEGMENTS, rounded

Row = dict[str, Any]
RUN_FRAMES = RUN_SEGMENTS * SEGMENT_FRAMES
# Columns of a run of segments: the number of their sequence is not known yet.
RUN = pa.schema([field for field in SEGMENTS if field.name != "sequence_index"])

# Text columns of a motion's provenance.
PROVENANCE = tuple(field.name for field in fields(Provenance) if field.name != "operations")


def motion_row(motion: Motion) -> Row:
    """A motion's row in the table of sequences, without its index and the location of its segments."""
    quality = measure(motion)
    return {
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
        "max_joint_speed_metres_per_second": quality.max_joint_speed,
        "floor_height_metres": quality.floor_height,
        "num_teleports": quality.num_teleports,
        "first_teleport_seconds": quality.first_teleport_seconds,
        "jitter_metres_per_second_cubed": quality.jitter,
        "frozen_seconds": quality.frozen_seconds,
        "frozen_start_seconds": quality.frozen_start_seconds,
        "held_share": quality.held_share,
        "foot_skate_metres_per_second": quality.foot_skate,
        "foot_skate_share": quality.foot_skate_share,
        "bone_length_drift": quality.bone_length_drift,
        "effective_fps": quality.effective_fps,
        "quality_flags": list(quality.flags),
        "num_segments": -(-motion.num_frames // SEGMENT_FRAMES),
    }


def write_frames(
    flat: Float32[np.ndarray, "values"], num_frames: int, out: Float32[np.ndarray, "frames *channels"]
) -> None:
    """Writes one segment's channel-major values into `out` [num_frames, …]."""
    out.reshape(num_frames, -1)[...] = flat.reshape(-1, num_frames).T


def motion_from_row(
    row: Row,
    skeleton: Skeleton,
    joint_positions: Float32[np.ndarray, "frames joints 3"],
    local_rotations: Float32[np.ndarray, "frames joints 4"] | None,
    root_translation: Float32[np.ndarray, "frames 3"] | None,
) -> Motion:
    """Rebuild the motion that `motion_row` described."""
    return Motion(
        joint_positions=joint_positions,
        skeleton=skeleton,
        timegrid=TimeGrid(
            Fraction(row["fps_numerator"], row["fps_denominator"]), row["num_frames"], row["start_seconds"]
        ),
        local_rotations=local_rotations,
        root_translation=root_translation,
        captions=tuple(Caption(**caption) for caption in row["captions"]),
        action=row["action"],
        style=row["style"],
        split=row["split"],
        sequence_id=row["sequence_id"],
        provenance=Provenance(**{name: row[name] for name in PROVENANCE}, operations=tuple(row["operations"])),
    )


def skeleton_row(skeleton: Skeleton) -> Row:
    """A skeleton's row in the table of skeletons; `offsets` are flat [J·3]."""
    feet = skeleton.feet
    return {
        "skeleton": skeleton.fingerprint,
        "name": skeleton.name,
        "joint_names": list(skeleton.joint_names),
        "parents": list(skeleton.parents),
        "offsets": skeleton.offsets.astype(np.float32).ravel().tolist(),
        "left_right_pairs": [{"left": left, "right": right} for left, right in skeleton.left_right_pairs],
        "feet": None if feet is None else vars(feet),
        "end_sites": [{"joint": joint, "x": x, "y": y, "z": z} for joint, (x, y, z) in skeleton.end_sites],
        "layout_map": skeleton.layout_map,
    }


def skeleton_from_row(row: Row) -> Skeleton:
    """Rebuild the skeleton that `skeleton_row` described."""
    return Skeleton(
        name=row["name"],
        joint_names=tuple(row["joint_names"]),
        parents=tuple(row["parents"]),
        offsets=np.array(row["offsets"], dtype=np.float32).reshape(-1, 3),
        left_right_pairs=tuple((pair["left"], pair["right"]) for pair in row["left_right_pairs"]),
        feet=None if row["feet"] is None else Feet(**row["feet"]),
        end_sites=tuple((site["joint"], (site["x"], site["y"], site["z"])) for site in row["end_sites"]),
        layout_map=row["layout_map"],
    )


def table_of(rows: Sequence[Mapping[str, Any]], schema: pa.Schema) -> pa.Table:
    """The table that `pa.Table.from_pylist` gives for rows which have every column of the schema."""
    columns = [array_of([row[field.name] for row in rows], field.type) for field in schema]
    return pa.Table.from_arrays(columns, schema=schema)


def array_of(values: Sequence[Any], kind: pa.DataType) -> pa.Array:
    """Numbers, truth values, texts, lists and structs of the given Arrow type; None is null.

    Raises `OverflowError` for an integer that does not fit.
    """
    present = [value is not None for value in values]
    validity = None
    if not all(present):
        validity, under_null = _bits(present), _empty(kind)
        values = [under_null if value is None else value for value in values]
    if pa.types.is_struct(kind):
        children = [array_of([value[field.name] for value in values], field.type) for field in kind]
        return pa.Array.from_buffers(kind, len(values), [validity], children=children)
    if pa.types.is_list(kind):
        elements = array_of([element for value in values for element in value], kind.value_type)
        return pa.Array.from_buffers(kind, len(values), [validity, _offsets(values)], children=[elements])
    if pa.types.is_string(kind):
        texts = [value.encode() for value in values]
        return pa.Array.from_buffers(kind, len(values), [validity, _offsets(texts), pa.py_buffer(b"".join(texts))])
    if pa.types.is_boolean(kind):
        return pa.Array.from_buffers(kind, len(values), [validity, _bits(values)])
    return _over(np.array(values, kind.to_pandas_dtype()), kind, validity)


def numbers_of(column: pa.Array | pa.ChunkedArray) -> Shaped[np.ndarray, " values"]:
    """A numeric column as a numpy array; raises `ValueError` for nulls."""
    array = column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column
    if array.null_count:
        raise ValueError(f"{array.null_count} of {len(array)} numbers are null")
    dtype = np.dtype(array.type.to_pandas_dtype())
    if not len(array):
        return np.empty(0, dtype)
    return np.frombuffer(array.buffers()[1], dtype, len(array), array.offset * dtype.itemsize)


def _over(values: Shaped[np.ndarray, " values"], kind: pa.DataType, validity: pa.Buffer | None) -> pa.Array:
    assert values.dtype == kind.to_pandas_dtype()
    return pa.Array.from_buffers(kind, len(values), [validity, pa.py_buffer(values)])


def _offsets(values: Sequence[Sequence[Any]]) -> pa.Buffer:
    return pa.py_buffer(np.cumsum([0, *map(len, values)], dtype=np.int32))


def _bits(values: Sequence[bool]) -> pa.Buffer:
    return pa.py_buffer(np.packbits(np.array(values, bool), bitorder="little"))


def _empty(kind: pa.DataType) -> Any:
    if pa.types.is_struct(kind):
        return {field.name: _empty(field.type) for field in kind}
    if pa.types.is_list(kind):
        return []
    if pa.types.is_string(kind):
        return ""
    return False if pa.types.is_boolean(kind) else 0


class RefusedMotion(StoreError):
    """A motion that cannot be stored; `reason` is a fixed slug.

    `duplicate-id`, `nan`, `no-id`, `frame-time`, `not-unicode`.
    """

    def __init__(self, message: str, *, reason: str) -> None:
        super().__init__(message)
        self.reason = reason


@dataclass(frozen=True, eq=False)
class EncodedMotion:
    """An encoded motion, without its location in the store.

    `row` is its row in the table of sequences without the index and the place; `runs` are its segments, at most 16 in
    each, with the columns of `RUN`. They may be computed lazily, and can then be iterated once.
    """

    row: Row
    skeleton: Skeleton
    runs: Iterable[pa.RecordBatch]

    @property
    def sequence_id(self) -> str:
        """The id under which it is stored."""
        return str(self.row["sequence_id"])

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return int(self.row["num_frames"])


def encode(motion: Motion) -> EncodedMotion:
    """Validates a motion, rounds it to 2^-22 and encodes it; its frames are encoded lazily, run by run.

    Raises `RefusedMotion` for one that cannot be stored.
    """
    _check(motion)
    motion = replace(motion, joint_positions=rounded(motion.joint_positions))  # measure what is stored
    return EncodedMotion(codec.motion_row(motion), motion.skeleton, _runs(motion))


def _runs(motion: Motion) -> Iterator[pa.RecordBatch]:
    # Run by run, so that no other copy of a long take is made.
    for start in range(0, motion.num_frames, RUN_FRAMES):
        starts = range(start, min(start + RUN_FRAMES, motion.num_frames), SEGMENT_FRAMES)
        counts = [min(SEGMENT_FRAMES, motion.num_frames - first) for first in starts]
        columns = [array_of(starts, pa.int32()), array_of(counts, pa.int16())]
        for array, on_grid in (
            (motion.joint_positions, True),
            (motion.local_rotations, False),
            (motion.root_translation, False),
        ):
            frames = None if array is None else array[start : start + RUN_FRAMES]
            columns.append(_lists(frames if frames is None or on_grid else rounded(frames), counts))
        yield pa.RecordBatch.from_arrays(columns, schema=RUN)


def _lists(frames: Float32[np.ndarray, "frames *channels"] | None, counts: Sequence[int]) -> pa.Array:
    """One list per segment of `counts` frames: channel-major, null if the motion has no such values."""
    if frames is None:
        return pa.nulls(len(counts), FLOAT_LIST)
    table = frames.reshape(len(frames), -1)
    flat = np.empty(table.size, np.float32)
    bounds = np.cumsum([0, *counts])
    for start, stop in pairwise(bounds):
        segment = table[start:stop]
        flat[start * table.shape[1] :][: segment.size].reshape(segment.shape[::-1])[...] = segment.T
    values = pa.Array.from_buffers(pa.float32(), flat.size, [None, pa.py_buffer(flat)])
    offsets = pa.py_buffer(bounds.astype(np.int64) * table.shape[1])
    return pa.Array.from_buffers(FLOAT_LIST, len(counts), [None, offsets], children=[values])


def _check(motion: Motion) -> None:
    if not motion.sequence_id:
        raise RefusedMotion("a motion needs a sequence_id to be stored", reason="no-id")
    try:
        "".join(_texts_of(motion)).encode()
    except UnicodeEncodeError:
        encoding = sys.getfilesystemencoding()
        hint = "rename the file" if encoding == "utf-8" else f"names are read as {encoding} here, set PYTHONUTF8=1"
        raise RefusedMotion(
            f"{motion.sequence_id!a}: a name or a text is not valid Unicode: {hint}", reason="not-unicode"
        ) from None
    if max(motion.fps.numerator, motion.fps.denominator) >= 2**63:
        raise RefusedMotion(f"the framerate {float(motion.fps):g} has too long a fraction", reason="frame-time")
    arrays = {
        "joint_positions": motion.joint_positions,
        "local_rotations": motion.local_rotations,
        "root_translation": motion.root_translation,
    }
    for name, array in arrays.items():
        if array is None or np.isfinite(array).all():
            continue
        frame = int(np.nonzero(~np.isfinite(array.reshape(len(array), -1)).all(axis=1))[0][0])
        raise RefusedMotion(
            f"{motion.sequence_id}: {name} are not finite from frame {frame} on: repair or cut it", reason="nan"
        )


def _texts_of(motion: Motion) -> list[str]:
    """Every string that goes into the tables: file names may not be valid Unicode."""
    provenance = motion.provenance
    captions = [text for caption in motion.captions for text in (caption.text, caption.tokens)]
    named = [value for value in vars(provenance).values() if isinstance(value, str)]
    return [motion.sequence_id, motion.action, motion.style, motion.split, *named, *provenance.operations, *captions]
