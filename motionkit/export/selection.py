"""Which sequences go out, and all that is known of them before the first frame is read."""

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np
import pyarrow as pa
from jaxtyping import Int64

from motionkit.motion import Motion
from motionkit.resample import resample
from motionkit.store.reader import Store


@dataclass(frozen=True, eq=False)
class Selection:
    """Sequences of a store by ascending index, at their own framerates or, with `fps`, resampled to one."""

    store: Store
    indices: Int64[np.ndarray, "sequences"]
    fps: Fraction | None = None

    @cached_property
    def table(self) -> pa.Table:
        """The sequences' rows of the store's table (columns: motionkit.store.schema.SEQUENCES)."""
        return self.store.sequences_table.take(self.store.rows_of(self.indices))

    @property
    def sequence_ids(self) -> list[str]:
        """Ids in order."""
        ids: list[str] = self.table["sequence_id"].to_pylist()
        return ids

    @property
    def framerates(self) -> tuple[Fraction, ...]:
        """The different framerates that will be written, ascending."""
        if self.fps is not None:
            return (self.fps,)
        columns = (self.table[name].to_pylist() for name in ("fps_numerator", "fps_denominator"))
        return tuple(sorted({Fraction(*pair) for pair in zip(*columns, strict=True)}))

    def motions(self) -> Iterator[Motion]:
        """The motions in order, one at a time in memory."""
        for motion in self.store.read_many(self.indices.tolist()):
            yield motion if self.fps is None else resample(motion, self.fps)


@dataclass(frozen=True)
class Outcome:
    """What became of one sequence; `reason` is a short slug and `message` says why it was left out, else empty."""

    sequence_id: str
    reason: str = ""
    message: str = ""

    @property
    def written(self) -> bool:
        """Whether the sequence is in the output."""
        return not self.reason
