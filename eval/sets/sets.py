"""Sets of motions at one framerate that a table compares, the identity of its rows, and what it lacks."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import Enum
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from eval.metrics.distributions import fit_gaussian, frechet_distance
from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.shapes import Float, Float32, Int64

ABOUT_EACH = ("sequence_ids", "captions", "actions", "groups", "takes", "generations")
"""Metadata of each sequence of a set; all but its id are optional."""
Frames = Float[np.ndarray, "_frames *_frame"]


@dataclass(frozen=True, eq=False)
class Ragged:
    """Concatenated sequences of different lengths: sequence i is `num_frames[i]` rows of `values` from `start_row[i]`.

    `values` [rows, …] are joint positions [rows, joints, 3] in metres, y up, unless stated otherwise; they may be a
    memory map, and have unused rows.
    """

    values: Float[np.ndarray, "rows *frame"]
    start_row: Int64[np.ndarray, "sequences"]
    num_frames: Int64[np.ndarray, "sequences"]

    @classmethod
    def of(cls, sequences: Sequence[Frames], dtype: npt.DTypeLike = np.float32) -> "Ragged":
        """Concatenate a copy of the sequences; raises `ValueError` for none."""
        values = np.concatenate(sequences).astype(dtype, copy=False)
        lengths = np.array([len(each) for each in sequences], dtype=np.int64)
        return cls(values, np.cumsum(lengths) - lengths, lengths)

    def __len__(self) -> int:
        return len(self.num_frames)

    def __getitem__(self, index: int | np.integer) -> Frames:
        start = int(self.start_row[index])
        return self.values[start : start + int(self.num_frames[index])]

    def __iter__(self) -> Iterator[Frames]:
        return (self[index] for index in range(len(self)))

    def select(self, indices: Sequence[int]) -> "Ragged":
        """The sequences at `indices`, in that order."""
        return Ragged.of([self[index] for index in indices], self.values.dtype)

    def clips(self, first_row: Int64[np.ndarray, "clips"], num_rows: int) -> Float[np.ndarray, "clips rows *frame"]:
        """Clips of one length that start at these rows of `values`."""
        return self.values[first_row[:, None] + np.arange(num_rows)]


def middle(frames: Frames, longest: int) -> Frames:
    """At most `longest` frames from the middle."""
    first = max(0, (len(frames) - longest) // 2)
    return frames[first : first + longest]


@dataclass(frozen=True, eq=False)
class SampleSet:
    """Sequences of joint positions at one framerate: 22 joints, or KIT-ML's 21 for its evaluator.

    `sequence_ids`, `captions`, `actions` ("" for none) and `groups` have one entry per sequence; motions of one group
    share a prompt. `takes` name the real take of each sequence, or the one it was generated for, if that is not its own
    id; `generations` number the generations of a system from 0, if there are several. `local_rotations`, if the motions
    have true ones, are unit quaternions (w, x, y, z) of the same rows, relative to the parent; SMPL's own skeleton may
    have 24 joints, the hands last.
    """

    name: str
    fps: Fraction
    sequences: Ragged
    sequence_ids: tuple[str, ...]
    captions: tuple[str, ...] = ()
    actions: tuple[str, ...] = ()
    local_rotations: Float32[np.ndarray, "rows rotations 4"] | None = None
    groups: tuple[str, ...] = ()
    takes: tuple[str, ...] = ()
    generations: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        for name in ABOUT_EACH:
            if len(values := getattr(self, name)) != len(self.sequences) and (values or name == "sequence_ids"):
                raise ValueError(f"{len(values)} {name} for {len(self.sequences)} sequences")
        if not np.isfinite(self.sequences.values).all():
            bad = next(index for index, each in enumerate(self.sequences) if not np.isfinite(each).all())
            raise ValueError(f"sample set {self.name!r}: sequence {self.sequence_ids[bad]!r} holds NaN or infinity")

    @property
    def num_sequences(self) -> int:
        """Number of sequences."""
        return len(self.sequences)

    @property
    def duration_seconds(self) -> float:
        """Seconds of motion in all."""
        return float(len(self.sequences.values) / self.fps)

    @property
    def take_names(self) -> tuple[str, ...]:
        """The take of each sequence, by default its own id."""
        return self.takes or self.sequence_ids

    @property
    def num_takes(self) -> int:
        """Number of different takes."""
        return len(set(self.take_names))

    def select(self, indices: Sequence[int] | npt.NDArray[np.int64]) -> "SampleSet":
        """The sequences at `indices`, in that order."""
        chosen, rotations = [int(index) for index in indices], self.local_rotations
        if rotations is not None:
            rotations = replace(self.sequences, values=rotations).select(chosen).values
        about: dict[str, Any] = {each: values for each in ABOUT_EACH if (values := getattr(self, each))}
        about = {each: tuple(values[index] for index in chosen) for each, values in about.items()}
        return replace(self, sequences=self.sequences.select(chosen), local_rotations=rotations, **about)

    def cut(self, num_frames: Int64[np.ndarray, "sequences"], rng: np.random.Generator) -> "SampleSet":
        """The sequences cut to at most these numbers of frames, beginning at a random frame."""
        starts = rng.integers(0, np.maximum(1, self.sequences.num_frames - num_frames + 1))
        cut = [each[first : first + n] for each, first, n in zip(self.sequences, starts, num_frames, strict=True)]
        return replace(self, sequences=Ragged.of(cut), local_rotations=None)

    def rows_by_group(self) -> dict[str, list[int]]:
        """The sequences of each prompt, prompts in order of appearance; without groups each is its own."""
        rows: dict[str, list[int]] = {}
        for index, group in enumerate(self.groups or self.sequence_ids):
            rows.setdefault(group, []).append(index)
        return rows

    def with_positions(
        self, sequences: Sequence[Frames], *, name: str | None = None, fps: Fraction | None = None
    ) -> "SampleSet":
        """The same sequences by id, with other positions, at another framerate if given, and no rotations."""
        sampled = Ragged.of(sequences)
        return replace(self, name=name or self.name, fps=fps or self.fps, sequences=sampled, local_rotations=None)


def sample_set(
    name: str,
    fps: Fraction,
    sequences: Sequence[Float32[np.ndarray, "_frames joints 3"]],
    sequence_ids: Sequence[str],
    captions: Sequence[str] = (),
    actions: Sequence[str] = (),
) -> SampleSet:
    """Concatenate sequences into a set. Raises `ValueError` for none, or for NaN."""
    return SampleSet(name, fps, Ragged.of(sequences), tuple(sequence_ids), tuple(captions), tuple(actions))


class Variant(Enum):
    """How a row's motions were made or changed; the value is the pattern of its name, {} being the system."""

    AS_IS = "{}"
    PLANTED = "{}, planted"
    DETAILED = "{}, planted, with detail"
    UPSAMPLED = "{} generated at 20 fps, SLERP"
    AS_VECTORS = "{} as vectors (handicapped)"
    HELD_OUT = "{}, held out"
    INDEPENDENT_DRAWS = "{}, independent draws (P1)"
    HALVES = "{}, disjoint halves of the takes (P2)"
    KEPT_AT_20 = "{} kept at 20 fps, SLERP"
    KEPT_AS_VECTORS = "{} kept at 20 fps, as vectors (handicapped)"
    AS_GENERATOR = "{}, as a generator"
    CUT = "{}, as long as generated motions"


@dataclass(frozen=True)
class RowId:
    """A row's system and variant; `str` is its name in the table."""

    system: str
    variant: Variant = Variant.AS_IS

    def __str__(self) -> str:
        return self.variant.value.format(self.system)


REAL, TRAINING_TAKES = RowId("real"), RowId("training takes")


def check_sample_names(samples: Iterable[str], systems: Iterable[str] = ()) -> None:
    """Raise `UsageError` for samples with a row named like another one: of these systems, of real motion, of samples.

    The systems' rows are those of every variant, the samples' as they are and planted.
    """
    known = (REAL.system, TRAINING_TAKES.system, *systems)
    names = {str(RowId(system, variant)) for system in known for variant in Variant}
    for system in samples:
        own = {str(RowId(system)), str(RowId(system, Variant.PLANTED))}
        if duplicates := sorted(own & names):
            raise UsageError(f"--samples {system}=…: there is a row {duplicates[0]!r} already; choose another name")
        names |= own


Errors = tuple[type[Exception], ...]


class Missing:
    """What a table lacks: a line for each, in order, without repetitions."""

    def __init__(self) -> None:
        self._lines: dict[str, None] = {}

    def add(self, *lines: str) -> None:
        """Add lines."""
        self._lines |= dict.fromkeys(lines)

    @contextmanager
    def skipping(self, label: str, errors: Errors = (MotionkitError,), raising: Errors = ()) -> Iterator[None]:
        """Leave out what raises one of these errors, as "label: error"; errors in `raising` are raised all the same."""
        try:
            yield
        except raising:
            raise
        except errors as error:
            self.add(f"{label}: {error}")

    @property
    def lines(self) -> tuple[str, ...]:
        """All lines."""
        return tuple(self._lines)

    def clear(self) -> None:
        """Remove all lines."""
        self._lines.clear()


CHOICES = 10
Features = Float[np.ndarray, "_samples features"]


def size_remark(reference: Features, other: Features, seed: int) -> str:
    """A remark on the FID of sets smaller than the reference, which are the real motions that FID compares with.

    It has the FID of equally many random motions of the reference against all of it: its mean, and the range of ten
    draws. Empty for a set that is no smaller.
    """
    if len(other) >= len(reference):
        return ""
    rng = np.random.default_rng((seed, 9))
    with threadpool_limits(1, "blas"):
        whole = fit_gaussian(reference)
        chosen = [rng.choice(len(reference), size=len(other), replace=False) for _ in range(CHOICES)]
        fids = [frechet_distance(whole, fit_gaussian(reference[rows])) for rows in chosen]
    return (
        f"as many random real motions ({len(other):,}) have an FID of {np.mean(fids):.3g} from all "
        f"({min(fids):.3g} to {max(fids):.3g} in {CHOICES} choices)"
    )
