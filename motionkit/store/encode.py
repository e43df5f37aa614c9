"""Motion → what the store keeps of it, wherever its place will be: the work that ingest leaves to its workers."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float32

from motionkit.errors import StoreError
from motionkit.motion import Motion
from motionkit.skeleton import Skeleton
from motionkit.store import codec
from motionkit.store.codec import Row
from motionkit.store.pages import Run, float_runs
from motionkit.store.resolution import rounded
from motionkit.store.schema import RUN_SEGMENTS, SEGMENT_FRAMES

RUN_FRAMES = RUN_SEGMENTS * SEGMENT_FRAMES


class RefusedMotion(StoreError):
    """A motion that may not enter a store; `reason` is a fixed slug.

    `duplicate-id`, `nan`, `no-id`, `frame-time`, `not-unicode`.
    """

    def __init__(self, message: str, *, reason: str) -> None:
        super().__init__(message)
        self.reason = reason


@dataclass(frozen=True, eq=False)
class EncodedMotion:
    """A motion as the store keeps it, but for its place; picklable, and nothing of it is computed again.

    `row` is its row in the table of sequences without the index and the place; `columns` are the columns of
    floats, in the order of the schema, compressed.
    """

    row: Row
    skeleton: Skeleton
    columns: tuple[tuple[Run, ...], ...]

    @property
    def sequence_id(self) -> str:
        """The id under which it is stored."""
        return str(self.row["sequence_id"])

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return int(self.row["num_frames"])


def encode(motion: Motion) -> EncodedMotion:
    """Check a motion, round it to 2^-22, describe it, and compress its frames in the order in which they are stored.

    Raises `RefusedMotion` for one that no store may hold.
    """
    _check(motion)
    motion = replace(motion, joint_positions=rounded(motion.joint_positions))  # what is stored is what is measured
    row = codec.motion_row(motion)
    arrays = (motion.joint_positions, motion.local_rotations, motion.root_translation)
    return EncodedMotion(row, motion.skeleton, tuple(_runs(array, motion.num_frames) for array in arrays))


def _runs(array: Float32[np.ndarray, "frames *channels"] | None, num_frames: int) -> tuple[Run, ...]:
    # Run by run, so that no other copy of a long take is made.
    if array is None:
        return float_runs(None, num_frames)
    parts = (rounded(array[start : start + RUN_FRAMES]) for start in range(0, num_frames, RUN_FRAMES))
    return tuple(run for part in parts for run in float_runs(_channel_major(part), len(part)))


def compressed(columns: Sequence[Float32[np.ndarray, "_"] | None], num_frames: int) -> tuple[tuple[Run, ...], ...]:
    """The columns of floats; each array holds the segments one after the other, each channel-major."""
    return tuple(float_runs(values, num_frames) for values in columns)


def _channel_major(frames: Float32[np.ndarray, "frames *channels"]) -> Float32[np.ndarray, "values"]:
    table = frames.reshape(len(frames), -1)
    flat = np.empty(table.size, np.float32)
    for start in range(0, len(table), SEGMENT_FRAMES):
        segment = table[start : start + SEGMENT_FRAMES]
        place = start * table.shape[1]
        flat[place : place + segment.size].reshape(segment.shape[::-1])[...] = segment.T
    return flat


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
