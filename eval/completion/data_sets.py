"""Data sets of a store for PA-HiRes' tables: real frames at the table's framerate, nothing interpolated."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from eval.sets.motions import NoRealMotionError, of_split_and
from motionkit.core.errors import UsageError
from motionkit.core.kinematics import closest_rotations, matrix_to_quaternion
from motionkit.core.shapes import Float32, Int64
from motionkit.data.rotation_sequences import open_rotation_sequences
from motionkit.store.cache import open_cache
from motionkit.store.reader import Store

Positions = Float32[np.ndarray, "clips frames joints 3"]
Vectors = Float32[np.ndarray, "clips frames numbers"]


@dataclass(frozen=True)
class DataSet:
    """Sequences of a store by a column's value (lower case), at a framerate."""

    name: str
    column: str
    value: str
    fps: Fraction

    @property
    def label(self) -> str:
        """CMU, 30 fps."""
        return f"{self.name}, {float(self.fps):g} fps"

    def holds(self, store: Store, sequence_index: Int64[np.ndarray, "sequences"]) -> np.ndarray:
        """Which of these sequences belong to it."""
        column = store.columns(self.column)[self.column].loc[sequence_index]
        return np.asarray(column.str.lower() == self.value)


# The paper's data sets at their framerates, and CMU at its native one beside them.
PUBLISHED = (
    DataSet("HumanML3D", "source_format", "humanml3d", Fraction(20)),
    DataSet("LaFAN1", "source_format", "lafan1", Fraction(30)),
    DataSet("CMU", "source", "cmu", Fraction(30)),
    DataSet("CMU", "source", "cmu", Fraction(120)),
)
USUAL_FPS = Fraction(30)


def data_sets_of(store: Store, fps: Sequence[Fraction] | None = None) -> list[DataSet]:
    """The paper's data sets, then the store's other sources at 30 fps; all of them at `fps` where it is given."""
    rows = store.columns("source", "source_format")
    published = np.zeros(len(rows), dtype=bool)
    for known in PUBLISHED:
        published |= np.asarray(rows[known.column].str.lower() == known.value)
    others = sorted({str(name) for name in rows["source"][~published]})
    data_sets = [*PUBLISHED, *(DataSet(name or "unnamed source", "source", name.lower(), USUAL_FPS) for name in others)]
    if fps is None:
        return data_sets
    return list(dict.fromkeys(replace(each, fps=rate) for each in data_sets for rate in fps))


def local_rotations(vectors: Float32[np.ndarray, "*frames numbers"]) -> Float32[np.ndarray, "*frames joints 4"]:
    """Unit quaternions of rotation rows (`features.rotations`)."""
    return matrix_to_quaternion(closest_rotations(vectors[..., 3:])).astype(np.float32)


@dataclass(frozen=True, eq=False)
class TrueClips:
    """Clips of equal length at the table's framerate: every `keep_every`-th frame of a sequence from `first_row` on.

    `sequence_index` is each clip's sequence in the store; those too short for a clip, and those whose framerate is no
    whole multiple of the table's, are counted.
    """

    fps: Fraction
    num_frames: int
    rows: Float32[np.ndarray, "total_frames numbers"]
    positions: Float32[np.ndarray, "total_frames joints 3"]
    first_row: Int64[np.ndarray, "clips"]
    keep_every: Int64[np.ndarray, "clips"]
    sequence_index: Int64[np.ndarray, "clips"]
    num_short: int
    num_other_fps: int

    @property
    def takes(self) -> tuple[str, ...]:
        """The take of each clip, named by its index in the store."""
        return tuple(map(str, self.sequence_index.tolist()))

    def read(self, size: int) -> Iterator[tuple[slice, Positions, Vectors]]:
        """Which clips, their positions in the world in metres and their rotation rows, `size` clips at a time."""
        for first in range(0, len(self.first_row), size):
            clips = slice(first, first + size)
            frames = np.arange(self.num_frames) * self.keep_every[clips, None] + self.first_row[clips, None]
            yield clips, self.positions[frames], self.rows[frames]


def open_clips(
    store: Store, data_set: DataSet, split: str, where: str | None, num_frames: int, every: int
) -> TrueClips:
    """Clips of `num_frames` frames from every `every`-th frame on, of the takes of one split ("all": any).

    Raises `NoRealMotionError` where the data set has no take of that split, framerate and length, and as `open_cache`.
    """
    condition = of_split_and(split, where)
    try:
        takes = open_rotation_sequences(store, data_set.fps, where=condition)
    except UsageError as error:  # nothing of any data set
        raise NoRealMotionError(str(error)) from None
    belongs = data_set.holds(store, takes.sequence_index)
    long_enough = belongs & (takes.num_frames >= num_frames)
    if not data_set.holds(store, store.select(None)).any():
        condition = f"{data_set.column} = {data_set.value!r}"
        raise NoRealMotionError(f"the store has none of it (motionkit ingest; {condition} is what is looked for)")
    if not long_enough.any():
        of_split = ("" if split == "all" else f" of split {split!r}") + (f" where {where}" if where else "")
        rate, few = f"a whole multiple of {float(data_set.fps):g} fps", f"{int(belongs.sum())} are shorter"
        raise NoRealMotionError(f"no take{of_split} has {rate} and then {num_frames} frames ({few})")
    cache = open_cache(store, where=condition)
    chosen = np.flatnonzero(long_enough)
    counts = (takes.num_frames[chosen] - num_frames) // every + 1
    take = np.repeat(chosen, counts)
    number = np.arange(len(take)) - np.repeat(np.cumsum(counts) - counts, counts)
    held = data_set.holds(store, cache.sequence_index.astype(np.int64))
    return TrueClips(
        fps=data_set.fps,
        num_frames=num_frames,
        rows=takes.rows,
        positions=cache.positions,
        first_row=takes.start_row[take] + number * every * takes.keep_every[take],
        keep_every=takes.keep_every[take],
        sequence_index=takes.sequence_index[take],
        num_short=int(belongs.sum() - long_enough.sum()),
        num_other_fps=int(held.sum() - belongs.sum()),
    )


def split_remark(store: Store, clips: TrueClips, split: str) -> str:
    """A remark on the performers of these clips, and how many of them are in the training split too."""
    rows = store.columns("source", "subject", "split")
    if (rows["subject"].loc[clips.sequence_index] == "").all():
        return "the store does not name performers, so the same people may be in the training split."
    performer = rows["source"] + "/" + rows["subject"]
    performers = set(performer.loc[clips.sequence_index])
    shared = performers & set(performer[rows["split"] == "train"])
    return f"{len(performers)} performers, {len(shared)} of whom are in the training split too, with other takes."
