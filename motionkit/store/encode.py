"""Motion → what the store keeps of it, wherever its place will be: a row of the table, and segments of its frames."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pyarrow as pa
from jaxtyping import Float32

from motionkit.core.errors import StoreError
from motionkit.core.motion import Motion
from motionkit.core.skeleton import Skeleton
from motionkit.store import codec
from motionkit.store.codec import Row, array_of
from motionkit.store.schema import FLOAT_LIST, RUN_SEGMENTS, SEGMENT_FRAMES, SEGMENTS, rounded

RUN_FRAMES = RUN_SEGMENTS * SEGMENT_FRAMES
# Columns of a run of segments: the number of their sequence is not known yet.
RUN = pa.schema([field for field in SEGMENTS if field.name != "sequence_index"])


class RefusedMotion(StoreError):
    """A motion that may not enter a store; `reason` is a fixed slug.

    `duplicate-id`, `nan`, `no-id`, `frame-time`, `not-unicode`.
    """

    def __init__(self, message: str, *, reason: str) -> None:
        super().__init__(message)
        self.reason = reason


@dataclass(frozen=True, eq=False)
class EncodedMotion:
    """A motion as the store keeps it, but for its place.

    `row` is its row in the table of sequences without the index and the place; `runs` are its segments, at most 16 in
    each, with the columns of `RUN`. They may be computed as they are asked for, and then can be asked for once.
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
    """Check a motion, round it to 2^-22 and describe it; its frames are brought into order run by run.

    Raises `RefusedMotion` for one that no store may hold.
    """
    _check(motion)
    motion = replace(motion, joint_positions=rounded(motion.joint_positions))  # what is stored is what is measured
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
    """One list for each segment, which has `counts` frames: channel-major, null where there are no such numbers."""
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
        raise RefusedMotion(
            f"{motion.sequence_id!a}: a name or a text is not valid Unicode: rename the file", reason="not-unicode"
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
            f"{motion.sequence_id}: {name} are not finite from frame {frame} on: mend or cut the take", reason="nan"
        )


def _texts_of(motion: Motion) -> list[str]:
    """Every text that goes into the tables: file names may hold bytes that are no characters."""
    provenance = motion.provenance
    captions = [text for caption in motion.captions for text in (caption.text, caption.tokens)]
    named = [value for value in vars(provenance).values() if isinstance(value, str)]
    return [motion.sequence_id, motion.action, motion.style, motion.split, *named, *provenance.operations, *captions]
