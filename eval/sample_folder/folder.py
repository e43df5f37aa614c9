"""Motions of one system in memory: one array in the 22-joint layout, a framerate, caption and action for each."""

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from itertools import groupby
from typing import TypeVar

import numpy as np

from eval.sets.sets import GrowingRagged, Ragged, SampleSet
from eval.sets.upsampled import each_upsampled
from motionkit.core.errors import FormatError, MotionkitError
from motionkit.core.shapes import Float32
from motionkit.core.skeleton import SMPL22
from motionkit.fields.resample import resample_positions

T = TypeVar("T")


class SampleFolderError(MotionkitError):
    """A folder of samples that cannot be used."""


@dataclass(frozen=True)
class SampleText:
    """Metadata of one motion; motions of one `group` share a prompt."""

    sequence_id: str
    caption: str = ""
    action: str = ""
    group: str = ""


@dataclass(frozen=True, eq=False)
class SampleFolder:
    """Motions of one system in the 22-joint layout (metres, y up), each at its stated framerate.

    Motions of one group share a prompt (for MultiModality); by default each is its own group. `left_out` are motions
    that could not be read, hold NaN or are no bodies, `remarks` messages about what was found and done.

    `vectors` are the pose vectors of every motion in their own units, with up to 3 stored frames of padding, if all
    came as vectors of one size and `SampleOptions.keep_published` is set; else empty. `kit_joints` are KIT-ML's 21
    joints in metres, if all motions came as these or as vectors of them.
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

    @property
    def num_motions(self) -> int:
        """Number of motions."""
        return len(self.sequences)

    @property
    def duration_seconds(self) -> float:
        """Seconds of motion in all."""
        lengths = self.sequences.num_frames
        return float(sum(int(frames) / fps for frames, fps in zip(lengths, self.fps, strict=True)))

    def select(self, indices: Sequence[int]) -> "SampleFolder":
        """The motions at these indices; `left_out` and `remarks` are kept."""

        def some(values: Sequence[T]) -> tuple[T, ...]:
            return tuple(values[index] for index in indices) if values else ()

        return replace(
            self,
            sequences=Ragged.of([self.sequences[index] for index in indices]),
            fps=some(self.fps),
            sequence_ids=some(self.sequence_ids),
            captions=some(self.captions),
            actions=some(self.actions),
            groups=some(self.groups),
            vectors=some(self.vectors),
            kit_joints=some(self.kit_joints),
        )

    @cached_property
    def fingerprint(self) -> str:
        """First 16 hex digits of the sha256 over framerates, lengths and positions."""
        digest = hashlib.sha256(repr([str(fps) for fps in self.fps]).encode())
        digest.update(self.sequences.num_frames.astype("<i8").tobytes())
        digest.update(np.ascontiguousarray(self.sequences.values, dtype="<f4").data)
        return digest.hexdigest()[:16]

    def at(self, fps: Fraction, on_motion: Callable[[], None] = lambda: None) -> SampleSet:
        """All motions at one framerate: slower ones are upsampled by SLERP, faster ones anti-aliased.

        If all are at that framerate, nothing is copied. `on_motion` is called after each motion.
        """
        sequences = self.sequences
        if any(own != fps for own in self.fps):
            made = GrowingRagged(SMPL22.num_joints)
            for sequence in self._resampled(fps):
                made.add(sequence)
                on_motion()
            sequences = made.finish()
        texts = (self.sequence_ids, self.captions, self.actions)
        return SampleSet(self.name, fps, sequences, *texts, groups=self.groups)

    def _resampled(self, fps: Fraction) -> Iterator[Float32[np.ndarray, "_frames joints 3"]]:
        for own, places in groupby(range(self.num_motions), key=self.fps.__getitem__):
            run = [self.sequences[place] for place in places]
            if own < fps:
                yield from each_upsampled(run, own, fps)
            else:
                yield from (resample_positions(sequence, own, fps) for sequence in run)

    def require_captions(self) -> None:
        """Raise `SampleFolderError` if a motion has no caption: text metrics need all."""
        self._require(self.captions, "caption", "text metrics compare each motion with its caption")

    def require_actions(self) -> None:
        """Raise `SampleFolderError` if a motion has no action: action metrics need all."""
        self._require(self.actions, "action", "accuracy compares each motion with its action")

    def describe(self) -> str:
        """A summary: number, duration and framerates of motions, and remarks."""
        rates = Counter(self.fps)
        listed = ", ".join(
            f"{float(fps):.5g} fps" + (f" ({rates[fps]:,})" if len(rates) > 1 else "") for fps in sorted(rates)
        )
        count = f"{self.num_motions:,} motion" + ("" if self.num_motions == 1 else "s")
        minutes = f"{self.duration_seconds / 60:.1f} min"
        lines = [f"{count} at {listed}, {minutes}; below a column's framerate they are upsampled by SLERP"]
        if self.left_out:
            lines.append(left_out_line(self.left_out, self.num_motions))
        return "; ".join((*lines, *self.remarks))

    def _require(self, values: Sequence[str], what: str, why: str) -> None:
        bare = [i for i, value in enumerate(values) if not value]
        if bare:
            raise SampleFolderError(
                f"--samples {self.name}: {len(bare):,} of {self.num_motions:,} motions have no {what}, the first is "
                f"{self.sequence_ids[bare[0]]!r}, and {why}; give a CSV beside them with the columns file,{what} "
                "(docs/samples.md)"
            )


def left_out_line(left_out: Sequence[FormatError], num_kept: int) -> str:
    """How many motions were left out and why, the first one in full."""
    reasons = ", ".join(
        f"{count:,} {reason}" for reason, count in Counter(one.reason for one in left_out).most_common()
    )
    return f"{len(left_out):,} of {len(left_out) + num_kept:,} motions left out ({reasons}); first: {left_out[0]}"


class Packer:
    """Collects motions with their framerates and texts."""

    def __init__(self) -> None:
        self._sequences = GrowingRagged(SMPL22.num_joints)
        self._fps: list[Fraction] = []
        self._texts: list[SampleText] = []
        self._vectors: list[Float32[np.ndarray, "_frames numbers"]] = []
        self._kit_joints: list[Float32[np.ndarray, "_frames 21 3"]] = []

    def __len__(self) -> int:
        return len(self._fps)

    def add(
        self,
        positions: Float32[np.ndarray, "_frames joints 3"],
        fps: Fraction,
        text: SampleText,
        vectors: Float32[np.ndarray, "_frames numbers"] | None = None,
        kit_joints: Float32[np.ndarray, "_frames 21 3"] | None = None,
    ) -> None:
        """Append a copy of one motion; its pose vectors and KIT joints, if any, are kept unchanged."""
        self._sequences.add(positions)
        self._fps.append(fps)
        self._texts.append(text)
        if vectors is not None:
            self._vectors.append(vectors)
        if kit_joints is not None:
            self._kit_joints.append(kit_joints)

    def finish(self, name: str, left_out: Sequence[FormatError], remarks: Sequence[str]) -> SampleFolder:
        """All motions that were added; nothing can be added afterwards."""
        return SampleFolder(
            name,
            self._sequences.finish(),
            tuple(self._fps),
            tuple(text.sequence_id for text in self._texts),
            tuple(text.caption for text in self._texts),
            tuple(text.action for text in self._texts),
            tuple(text.group or text.sequence_id for text in self._texts),
            tuple(left_out),
            tuple(remarks),
            self._all_vectors(),
            tuple(self._kit_joints) if len(self._kit_joints) == len(self) else (),
        )

    def _all_vectors(self) -> tuple[Float32[np.ndarray, "_frames numbers"], ...]:
        sizes = {motion.shape[1] for motion in self._vectors}
        return tuple(self._vectors) if len(self._vectors) == len(self) and len(sizes) == 1 else ()
