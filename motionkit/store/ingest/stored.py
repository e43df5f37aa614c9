"""Warnings about ingested sequences, and counts of metadata that training needs."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction

from motionkit.core.errors import FormatError
from motionkit.io.scan.cuts import missing_seconds, unlike_stated_seconds
from motionkit.io.scan.items import SourceItem
from motionkit.io.smpl_body import substituted_body
from motionkit.store.codec import Row

# Before its second frame a jump may be seen one frame late.
FIRST_FRAMES = 2


@dataclass
class StoredCounts:
    """Numbers of stored sequences with each quality flag, any flag, a split, a performer."""

    flags: Counter[str] = field(default_factory=Counter)
    num_flagged: int = 0
    num_in_splits: int = 0
    num_with_performer: int = 0

    def add(self, row: Row) -> None:
        """Count one row of the table of sequences."""
        self.flags.update(row["quality_flags"])
        self.num_flagged += bool(row["quality_flags"])
        self.num_in_splits += bool(row["split"])
        self.num_with_performer += bool(row["subject"])


def warnings_of(item: SourceItem, row: Row) -> Iterator[FormatError]:
    """Warnings about a stored motion; `row` is its row in the table of sequences.

    `neutral-body`: no model of the subject's gender; `first-frame`: a jump after the first frame; `shortened`, or
    `duration` for a whole file: the file's length differs from the index's.
    """
    substitute = substituted_body(row["operations"])
    if substitute:
        yield FormatError(substitute, path=item.path, reason="neutral-body")
    if item.cut is None:
        yield from _jump_at_start(item, row)
        return
    fps = Fraction(row["fps_numerator"], row["fps_denominator"])
    seconds = row["duration_seconds"]
    missing = missing_seconds(item.cut, item.path, row["num_frames"], fps, row["stated_fps"])
    if missing > 0.0:
        message = f"ends {missing:.3g} s before {item.sequence_id} does; {seconds:.3g} s of it are kept"
        yield FormatError(message, path=item.path, reason="shortened")
    elif unlike_stated_seconds(item.cut, row["num_frames"], fps):
        message = (
            f"lasts {seconds:.4g} s at {float(fps):g} fps, which is not what the index says of {item.sequence_id}; "
        )
        message += "its captions' seconds won't fit: is the framerate wrong (--fps-rules)?"
        yield FormatError(message, path=item.path, reason="duration")


def _jump_at_start(item: SourceItem, row: Row) -> Iterator[FormatError]:
    # Converters put a T-pose before the motion.
    jump, frame = row["first_teleport_seconds"], row["seconds_between_frames"]
    if jump is not None and jump < (FIRST_FRAMES + 0.5) * frame:
        message = (
            f"jumps at {jump:.3g} s: does it begin with a reference pose? --skip-frames N leaves out the first frames "
            "of every file, a column skip_frames of the annotation table those of one"
        )
        yield FormatError(message, path=item.path, reason="first-frame")
