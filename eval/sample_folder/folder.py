"""Motions of one system in memory, in the 22-joint layout, and the real takes that they belong to."""

import hashlib
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from itertools import cycle
from pathlib import Path
from typing import Literal

import numpy as np

from eval.sets.motions import RealMotion, at_framerate
from eval.sets.sets import Ragged, SampleSet
from motionkit.core.errors import FormatError, MotionkitError, counted
from motionkit.core.shapes import Float32


class SampleFolderError(MotionkitError):
    """A folder of samples that cannot be used."""


@dataclass(frozen=True, eq=False)
class SampleMotion:
    """One motion of the file `path` in metres, y up; motions of one `group` share a prompt ("": its own).

    `vectors` are its pose vectors in their own units and `kit_joints` KIT-ML's 21 joints, if it came as these.
    """

    sequence_id: str
    positions: Float32[np.ndarray, "frames 22 3"]
    fps: Fraction
    caption: str = ""
    action: str = ""
    group: str = ""
    vectors: Float32[np.ndarray, "frames numbers"] | None = None
    kit_joints: Float32[np.ndarray, "frames 21 3"] | None = None
    path: Path = Path()


@dataclass(frozen=True, eq=False)
class SampleFolder:
    """Motions of one system in the 22-joint layout (metres, y up), each at its stated framerate.

    Motions of one group share a prompt (for MultiModality); by default each is its own group. `left_out` are motions
    that could not be read, hold NaN or are no bodies, `remarks` messages about what was found and done.

    `vectors` are the pose vectors of every motion in their own units if all came as vectors of one size, `kit_joints`
    KIT-ML's 21 joints in metres if all came as these or as vectors of them; empty without
    `SampleOptions.keep_published`.
    """

    name: str
    sequences: Ragged
    fps: tuple[Fraction, ...]
    sequence_ids: tuple[str, ...]
    captions: tuple[str, ...]
    actions: tuple[str, ...]
    groups: tuple[str, ...]
    left_out: tuple[FormatError, ...] = ()
    remarks: tuple[str, ...] = ()
    vectors: tuple[Float32[np.ndarray, "_frames numbers"], ...] = ()
    kit_joints: tuple[Float32[np.ndarray, "_frames 21 3"], ...] = ()

    @classmethod
    def of(
        cls,
        name: str,
        motions: Sequence[SampleMotion],
        left_out: Sequence[FormatError] = (),
        remarks: Sequence[str] = (),
    ) -> "SampleFolder":
        """A folder of one motion or more."""
        vectors = tuple(motion.vectors for motion in motions if motion.vectors is not None)
        kit_joints = tuple(motion.kit_joints for motion in motions if motion.kit_joints is not None)
        all_vectors = len(vectors) == len(motions) and len({rows.shape[1] for rows in vectors}) == 1
        return cls(
            name=name,
            sequences=Ragged.of([motion.positions for motion in motions]),
            fps=tuple(motion.fps for motion in motions),
            sequence_ids=tuple(motion.sequence_id for motion in motions),
            captions=tuple(motion.caption for motion in motions),
            actions=tuple(motion.action for motion in motions),
            groups=tuple(motion.group or motion.sequence_id for motion in motions),
            left_out=tuple(left_out),
            remarks=tuple(remarks),
            vectors=vectors if all_vectors else (),
            kit_joints=kit_joints if len(kit_joints) == len(motions) else (),
        )

    @property
    def duration_seconds(self) -> float:
        """Seconds of motion in all."""
        lengths = self.sequences.num_frames
        return float(sum(int(frames) / fps for frames, fps in zip(lengths, self.fps, strict=True)))

    @cached_property
    def fingerprint(self) -> str:
        """First 16 hex digits of the sha256 over framerates, lengths and positions."""
        digest = hashlib.sha256(repr([str(fps) for fps in self.fps]).encode())
        digest.update(self.sequences.num_frames.astype("<i8").tobytes())
        digest.update(np.ascontiguousarray(self.sequences.values, dtype="<f4").data)
        return digest.hexdigest()[:16]

    def at(self, fps: Fraction) -> SampleSet:
        """All motions at one framerate: slower ones are upsampled by SLERP, faster ones anti-aliased.

        If all are at that framerate, nothing is copied.
        """
        texts = (self.sequence_ids, self.captions, self.actions)
        samples = SampleSet(self.name, fps, self.sequences, *texts, groups=self.groups)
        if all(own == fps for own in self.fps):
            return samples
        pairs = zip(self.sequences, self.fps, strict=True)
        return samples.with_positions([at_framerate(sequence, own, fps) for sequence, own in pairs])

    def describe(self) -> str:
        """A summary: number, duration and framerates of motions, and remarks."""
        rates = Counter(self.fps)
        listed = ", ".join(
            f"{float(fps):.5g} fps" + (f" ({rates[fps]:,})" if len(rates) > 1 else "") for fps in sorted(rates)
        )
        count, minutes = counted(len(self.sequences), "motion"), f"{self.duration_seconds / 60:.1f} min"
        lines = [f"{count} at {listed}, {minutes}; below a column's framerate they are upsampled by SLERP"]
        if self.left_out:
            lines.append(left_out_line(self.left_out, len(self.sequences)))
        return "; ".join((*lines, *self.remarks))

    def require(self, what: Literal["caption", "action"]) -> None:
        """Raise `SampleFolderError` if a motion has no caption, or no action: metrics of these need all."""
        values = self.captions if what == "caption" else self.actions
        bare = [i for i, value in enumerate(values) if not value]
        if bare:
            raise SampleFolderError(
                f"--samples {self.name}: {len(bare):,} of {len(values):,} motions have no {what}, the first is "
                f"{self.sequence_ids[bare[0]]!r}; give a CSV beside them with the columns file,{what} (docs/samples.md)"
            )


def left_out_line(left_out: Sequence[FormatError], num_kept: int) -> str:
    """How many motions were left out and why, the first one in full."""
    reasons = ", ".join(
        f"{count:,} {reason}" for reason, count in Counter(one.reason for one in left_out).most_common()
    )
    return f"{len(left_out):,} of {len(left_out) + num_kept:,} motions left out ({reasons}); first: {left_out[0]}"


def rows_by_name(sample_ids: Sequence[str], real_ids: Sequence[str]) -> list[int | None]:
    """The row of the real sequence whose id is a sample's name, or its file's stem."""
    by_name = {name: row for row, name in enumerate(real_ids)}
    stems = [name.rsplit("/", 1)[-1].rsplit(".", 1)[0] for name in sample_ids]
    return [by_name.get(name, by_name.get(stem)) for name, stem in zip(sample_ids, stems, strict=True)]


def takes_of_samples(folder: SampleFolder, real: RealMotion) -> tuple[str, ...]:
    """The real take of each motion, "" for none: by names if most of them are real sequences', else by captions.

    Prompts with the same caption are assigned to its takes in turn, the fastest first, so that a single sample of a
    caption is used at as many framerates as possible. Samples of one prompt have one take.
    """
    named = rows_by_name(folder.sequence_ids, real.sequence_ids)
    if 2 * sum(row is not None for row in named) > len(named):
        return tuple("" if row is None else real.sequence_ids[row] for row in named)
    by_caption: dict[str, list[str]] = defaultdict(list)
    for row in sorted(range(len(real.fps)), key=lambda row: -real.fps[row]):
        if real.captions[row]:
            by_caption[real.captions[row]].append(real.sequence_ids[row])
    in_turn = {caption: cycle(takes) for caption, takes in by_caption.items()}
    take_of_group: dict[str, str] = {}
    for group, caption in zip(folder.groups, folder.captions, strict=True):
        if caption in in_turn and group not in take_of_group:
            take_of_group[group] = next(in_turn[caption])
    return tuple(take_of_group.get(group, "") for group in folder.groups)


def samples_of_takes(samples: SampleSet, takes: Sequence[str], real: SampleSet) -> SampleSet | None:
    """The samples for a column's takes, each with its take and generation; None if there are none.

    Without known takes, all samples; those of one prompt are then resampled together.
    """
    if not any(takes):
        return replace(samples, takes=samples.groups)
    compared = set(real.sequence_ids)
    chosen = [index for index, take in enumerate(takes) if take in compared]
    if not chosen:
        return None
    own = tuple(takes[index] for index in chosen)
    generations = tuple(own[:number].count(take) for number, take in enumerate(own))
    return replace(samples.select(chosen), takes=own, generations=generations if any(generations) else ())
