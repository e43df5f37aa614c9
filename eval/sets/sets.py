"""Sequences of different lengths in one array, and sets of them at one framerate that a table compares."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

from motionkit.core.shapes import Float32, Int64

ABOUT_EACH = ("captions", "actions", "groups", "takes", "generations")
"""Optional metadata of each sequence of a set, beside its id."""
Frames = Float32[np.ndarray, "_frames *_frame"]


@dataclass(frozen=True, eq=False)
class Ragged:
    """Concatenated sequences of different lengths: sequence i is `num_frames[i]` rows of `values` from `start_row[i]`.

    `values` [rows, …] are joint positions [rows, joints, 3] in metres, y up, unless stated otherwise; they may be a
    memory map, and have unused rows.
    """

    values: Float32[np.ndarray, "rows *frame"]
    start_row: Int64[np.ndarray, "sequences"]
    num_frames: Int64[np.ndarray, "sequences"]

    @classmethod
    def laid_out(
        cls, values: Float32[np.ndarray, "rows *frame"], num_frames: Sequence[int] | npt.NDArray[np.int64]
    ) -> "Ragged":
        """Sequences of these lengths. Raises `ValueError` if they do not add up to the number of rows."""
        lengths = np.asarray(num_frames, dtype=np.int64)
        if int(lengths.sum()) != len(values):
            raise ValueError(f"{len(values)} rows for sequences of {int(lengths.sum())} frames in all")
        return cls(values, np.cumsum(lengths) - lengths, lengths)

    @classmethod
    def of(cls, sequences: Sequence[Frames]) -> "Ragged":
        """Concatenate a copy of the sequences; raises `ValueError` for none."""
        return cls.laid_out(np.concatenate(sequences).astype(np.float32, copy=False), [len(each) for each in sequences])

    def __len__(self) -> int:
        return len(self.num_frames)

    def __getitem__(self, index: int | np.integer) -> Frames:
        start = int(self.start_row[index])
        return self.values[start : start + int(self.num_frames[index])]

    def __iter__(self) -> Iterator[Frames]:
        return (self[index] for index in range(len(self)))

    def clips(self, first_row: Int64[np.ndarray, "clips"], num_rows: int) -> Float32[np.ndarray, "clips rows *frame"]:
        """Stretches of one length that start at these rows of `values`."""
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
        texts = {name: getattr(self, name) for name in ABOUT_EACH}
        for name, values in {"ids": self.sequence_ids, **texts}.items():
            if len(values) not in ((len(self.sequences),) if name == "ids" else (0, len(self.sequences))):
                raise ValueError(f"{len(values)} {name} for {len(self.sequences)} sequences")
        rows = len(self.sequences.values)
        if self.local_rotations is not None and len(self.local_rotations) != rows:
            raise ValueError(f"{len(self.local_rotations)} rows of rotations for {rows} of positions")

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

    def select(self, indices: Sequence[int] | npt.NDArray[np.int64], name: str | None = None) -> "SampleSet":
        """The sequences at `indices`, in that order, optionally under another name."""
        chosen = [int(index) for index in indices]
        made = sample_set(
            name or self.name,
            self.fps,
            [self.sequences[index] for index in chosen],
            [self.sequence_ids[index] for index in chosen],
        )
        known: dict[str, Any] = {name: getattr(self, name) for name in ABOUT_EACH if getattr(self, name)}
        about: dict[str, Any] = {name: tuple(each[index] for index in chosen) for name, each in known.items()}
        made = replace(made, **about)
        if self.local_rotations is None:
            return made
        rotations = replace(self.sequences, values=self.local_rotations)
        return replace(made, local_rotations=np.concatenate([rotations[index] for index in chosen]))

    def rows_by_group(self) -> dict[str, list[int]]:
        """The sequences of each prompt, prompts in order of appearance; without groups each is its own."""
        found: dict[str, list[int]] = {}
        for index, group in enumerate(self.groups or self.sequence_ids):
            found.setdefault(group, []).append(index)
        return found

    def with_positions(
        self, name: str, fps: Fraction, sequences: Sequence[Float32[np.ndarray, "_frames joints 3"]]
    ) -> "SampleSet":
        """The same sequences by id, with other positions at another framerate and no rotations."""
        made = sample_set(name, fps, sequences, self.sequence_ids)
        return replace(made, **{name: getattr(self, name) for name in ABOUT_EACH})

    def __repr__(self) -> str:
        return (
            f"SampleSet({self.name!r}, {self.num_sequences} sequences, {self.duration_seconds:.1f} s at {self.fps} fps)"
        )


def sample_set(
    name: str,
    fps: Fraction,
    sequences: Sequence[Float32[np.ndarray, "_frames joints 3"]],
    sequence_ids: Sequence[str],
    captions: Sequence[str] = (),
    actions: Sequence[str] = (),
    groups: Sequence[str] = (),
) -> SampleSet:
    """Concatenate sequences into a set. Raises `ValueError` for none, or for NaN."""
    if not len(sequences):
        raise ValueError(f"sample set {name!r} would hold no sequence")
    laid_out = Ragged.of(sequences)
    if not np.isfinite(laid_out.values).all():
        bad = next(i for i, sequence in enumerate(sequences) if not np.isfinite(sequence).all())
        raise ValueError(f"sample set {name!r}: sequence {sequence_ids[bad]!r} holds NaN or infinity")
    texts = (tuple(sequence_ids), tuple(captions), tuple(actions))
    return SampleSet(name, fps, laid_out, *texts, groups=tuple(groups))
