"""Sample sets: motions of one framerate, real, upsampled or generated, that a table compares."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property

import numpy as np
import numpy.typing as npt
from jaxtyping import Float32, Int64


@dataclass(frozen=True, eq=False)
class SampleSet:
    """Sequences of joint positions at one framerate, one after another in `positions` [rows, joints, 3] (metres, y up).

    There are 22 joints, or KIT-ML's 21 where its evaluator is to read them.
    Sequence i holds rows start_row[i] … start_row[i] + num_frames[i]; `sequence_ids`, `captions` and `actions` have one
    entry each ("" where there is none), and so have `groups`: motions of one group answer the same prompt.
    `local_rotations`, where motions have true ones, are unit quaternions (w, x, y, z) of the same rows, relative to the
    parent; SMPL's own skeleton may give 24 joints, the hands last.
    """

    name: str
    fps: Fraction
    positions: Float32[np.ndarray, "rows joints 3"]
    num_frames: Int64[np.ndarray, "sequences"]
    sequence_ids: tuple[str, ...]
    captions: tuple[str, ...] = ()
    actions: tuple[str, ...] = ()
    local_rotations: Float32[np.ndarray, "rows rotations 4"] | None = None
    groups: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if int(self.num_frames.sum()) != len(self.positions):
            raise ValueError(f"{len(self.positions)} rows for sequences of {int(self.num_frames.sum())} frames in all")
        texts = {"captions": self.captions, "actions": self.actions, "groups": self.groups}
        for name, values in {"ids": self.sequence_ids, **texts}.items():
            if len(values) not in ((len(self.num_frames),) if name == "ids" else (0, len(self.num_frames))):
                raise ValueError(f"{len(values)} {name} for {len(self.num_frames)} sequences")
        if self.local_rotations is not None and len(self.local_rotations) != len(self.positions):
            raise ValueError(f"{len(self.local_rotations)} rows of rotations for {len(self.positions)} of positions")

    @property
    def num_sequences(self) -> int:
        """Number of sequences."""
        return len(self.num_frames)

    @cached_property
    def start_row(self) -> Int64[np.ndarray, "sequences"]:
        """First row of every sequence."""
        return np.asarray(np.cumsum(self.num_frames) - self.num_frames, dtype=np.int64)

    @property
    def duration_seconds(self) -> float:
        """Seconds of motion in all."""
        return float(len(self.positions) / self.fps)

    def sequence(self, index: int) -> Float32[np.ndarray, "frames joints 3"]:
        """Joint positions of one sequence."""
        start = int(self.start_row[index])
        return self.positions[start : start + int(self.num_frames[index])]

    def sequences(self) -> Iterator[Float32[np.ndarray, "_frames joints 3"]]:
        """Joint positions, sequence by sequence."""
        return (self.sequence(index) for index in range(self.num_sequences))

    def select(self, indices: Sequence[int] | npt.NDArray[np.int64], name: str | None = None) -> "SampleSet":
        """The sequences at `indices`, in that order, under another name where one is given."""
        chosen = [int(index) for index in indices]
        made = sample_set(
            name or self.name,
            self.fps,
            [self.sequence(index) for index in chosen],
            [self.sequence_ids[index] for index in chosen],
            [self.captions[index] for index in chosen] if self.captions else (),
            [self.actions[index] for index in chosen] if self.actions else (),
            [self.groups[index] for index in chosen] if self.groups else (),
        )
        if self.local_rotations is None:
            return made
        rows = np.concatenate([self.start_row[index] + np.arange(self.num_frames[index]) for index in chosen])
        return replace(made, local_rotations=self.local_rotations[rows])

    def rows_by_group(self) -> dict[str, list[int]]:
        """Which sequences answer each prompt, prompts in order of appearance; without groups each its own."""
        found: dict[str, list[int]] = {}
        for index, group in enumerate(self.groups or self.sequence_ids):
            found.setdefault(group, []).append(index)
        return found

    def with_positions(
        self, name: str, fps: Fraction, sequences: Sequence[Float32[np.ndarray, "_frames joints 3"]]
    ) -> "SampleSet":
        """The same sequences by id, with other positions at another framerate and no rotations."""
        made = sample_set(name, fps, sequences, self.sequence_ids)
        return replace(made, captions=self.captions, actions=self.actions, groups=self.groups)

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
    """Lay sequences one after another. Raises `ValueError` where there is none or one holds NaN."""
    if not len(sequences):
        raise ValueError(f"sample set {name!r} would hold no sequence")
    positions = np.concatenate(sequences).astype(np.float32, copy=False)
    if not np.isfinite(positions).all():
        bad = next(i for i, sequence in enumerate(sequences) if not np.isfinite(sequence).all())
        raise ValueError(f"sample set {name!r}: sequence {sequence_ids[bad]!r} holds NaN or infinity")
    num_frames = np.array([len(sequence) for sequence in sequences], dtype=np.int64)
    texts = (tuple(sequence_ids), tuple(captions), tuple(actions))
    return SampleSet(name, fps, positions, num_frames, *texts, groups=tuple(groups))
