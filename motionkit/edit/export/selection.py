"""The sequences to export, their output names, and their metadata."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import PurePosixPath

import numpy as np
import pyarrow as pa

from motionkit.core.errors import UsageError
from motionkit.core.motion import Motion
from motionkit.core.shapes import Int64
from motionkit.fields.resample import resample
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
    """The outcome of one sequence; `reason` (a short slug) and `message` say why it was skipped, else empty.

    `lacks` names missing metadata of a written sequence that the format's readers need.
    """

    sequence_id: str
    reason: str = ""
    message: str = ""
    lacks: tuple[str, ...] = ()

    @property
    def written(self) -> bool:
        """Whether the sequence is in the output."""
        return not self.reason


def nested_names(sequence_ids: Sequence[str], suffix: str) -> list[PurePosixPath]:
    """`a/b` → `a/b.SUFFIX`; raises `UsageError` for an id that is not a path below a folder, or is repeated."""
    return _distinct(sequence_ids, [_below(sequence_id, suffix) for sequence_id in sequence_ids])


def flat_names(sequence_ids: Sequence[str], suffix: str = "") -> list[PurePosixPath]:
    """`a/b` → `a_b.SUFFIX`, all in one folder; raises `UsageError` as `nested_names` does."""
    below = [_below(sequence_id, suffix) for sequence_id in sequence_ids]
    return _distinct(sequence_ids, [PurePosixPath(path.as_posix().replace("/", "_")) for path in below])


def short_names(sequence_ids: Sequence[str]) -> list[PurePosixPath]:
    """The last part of each id if these are unique (`HumanML3D/000021` → `000021`), else as `flat_names`."""
    last = [PurePosixPath(_below(sequence_id, "").name) for sequence_id in sequence_ids]
    return last if len(set(last)) == len(last) else flat_names(sequence_ids)


def _below(sequence_id: str, suffix: str) -> PurePosixPath:
    parts = PurePosixPath(sequence_id).parts
    if not parts or parts[0] == "/" or ".." in parts or "\0" in sequence_id:
        raise UsageError(f"the id {sequence_id!r} cannot be a file's name: leave the sequence out with --where")
    return PurePosixPath(*parts[:-1], parts[-1] + suffix)


def _distinct(sequence_ids: Sequence[str], names: list[PurePosixPath]) -> list[PurePosixPath]:
    taken, count = Counter(names).most_common(1)[0] if names else (None, 0)
    if count > 1:
        ids = " and ".join(repr(one) for one, name in zip(sequence_ids, names, strict=True) if name == taken)
        raise UsageError(f"{ids} would be written to one file, {taken}: choose one of them with --where")
    return names
