"""Motions of one system in memory: one array in the 22-joint layout, a framerate, caption and action for each."""

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import groupby

import numpy as np
from jaxtyping import Float32, Int64

from eval.sets.sets import SampleSet
from eval.sets.upsampled import each_upsampled
from motionkit.core.errors import FormatError, MotionkitError
from motionkit.core.skeleton import SMPL22
from motionkit.fields.resample import resample_positions

FIRST_CAPACITY = 1 << 12


class SampleFolderError(MotionkitError):
    """A folder of samples that cannot be used."""


@dataclass(frozen=True)
class SampleText:
    """What is known of one motion beside its poses; motions of one `group` answer the same prompt."""

    sequence_id: str
    caption: str = ""
    action: str = ""
    group: str = ""


@dataclass(frozen=True, eq=False)
class SampleFolder:
    """Motions of one system in the 22-joint layout (metres, y up), each at the framerate that is stated for it.

    Sequence i holds rows start_row[i] … start_row[i] + num_frames[i] of `positions`. Motions of one group answer the
    same prompt (MultiModality); where nothing says so, each is its own group. `left_out` are the motions that could not
    be read or hold NaN, `remarks` what was found and done, for people.

    `vectors` are the pose vectors of every motion, in their own units, as many frames as its positions and up to 3 of
    the padding that was stored after them: where all came as vectors of one size and were to be kept
    (`SampleOptions.keep_published`); else empty. `kit_joints` are KIT-ML's
    21 joints in metres, likewise: where all motions came as these or as vectors of them.
    """

    name: str
    positions: Float32[np.ndarray, "rows joints 3"]
    num_frames: Int64[np.ndarray, "sequences"]
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
        return len(self.num_frames)

    @property
    def duration_seconds(self) -> float:
        """Seconds of motion in all."""
        return float(sum(int(frames) / fps for frames, fps in zip(self.num_frames, self.fps, strict=True)))

    @cached_property
    def start_row(self) -> Int64[np.ndarray, "sequences"]:
        """First row of every motion."""
        return np.asarray(np.cumsum(self.num_frames) - self.num_frames, dtype=np.int64)

    @property
    def sequences(self) -> list[Float32[np.ndarray, "_frames joints 3"]]:
        """Joint positions, motion by motion: views of `positions`."""
        return [
            self.positions[start : start + length]
            for start, length in zip(self.start_row.tolist(), self.num_frames.tolist(), strict=True)
        ]

    @cached_property
    def fingerprint(self) -> str:
        """First 16 hex digits of the sha256 over framerates, lengths and positions."""
        digest = hashlib.sha256(repr([str(fps) for fps in self.fps]).encode())
        digest.update(self.num_frames.astype("<i8").tobytes())
        digest.update(np.ascontiguousarray(self.positions, dtype="<f4").data)
        return digest.hexdigest()[:16]

    def at(self, fps: Fraction, on_motion: Callable[[], None] = lambda: None) -> SampleSet:
        """All motions at one framerate: those that are slower are upsampled by SLERP, faster ones are anti-aliased.

        Motions that are all at that framerate are handed on as they lie in memory. `on_motion` is called after each.
        """
        positions, num_frames = self.positions, self.num_frames
        if any(own != fps for own in self.fps):
            rows, lengths = Rows(), []
            for sequence in self._resampled(fps):
                rows.add(sequence)
                lengths.append(len(sequence))
                on_motion()
            positions, num_frames = rows.finish(), np.array(lengths, dtype=np.int64)
        texts = (self.sequence_ids, self.captions, self.actions)
        return SampleSet(self.name, fps, positions, num_frames, *texts, groups=self.groups)

    def _resampled(self, fps: Fraction) -> Iterator[Float32[np.ndarray, "_frames joints 3"]]:
        sequences = self.sequences
        for own, places in groupby(range(self.num_motions), key=self.fps.__getitem__):
            run = [sequences[place] for place in places]
            if own < fps:
                yield from each_upsampled(run, own, fps)
            else:
                yield from (resample_positions(sequence, own, fps) for sequence in run)

    def require_captions(self) -> None:
        """Raise `SampleFolderError` where a motion has no caption: text metrics need them all."""
        self._require(self.captions, "caption", "text metrics compare each motion with its caption")

    def require_actions(self) -> None:
        """Raise `SampleFolderError` where a motion has no action: action metrics need them all."""
        self._require(self.actions, "action", "accuracy compares each motion with its action")

    def describe(self) -> str:
        """How many motions there are, how long, at which framerates, and what was remarkable."""
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
    """How many motions are missing and why, the first one in full."""
    reasons = ", ".join(
        f"{count:,} {reason}" for reason, count in Counter(one.reason for one in left_out).most_common()
    )
    return f"{len(left_out):,} of {len(left_out) + num_kept:,} motions left out ({reasons}); first: {left_out[0]}"


class Rows:
    """Poses of any number of motions in one array that grows in place, so that nothing is held twice."""

    def __init__(self) -> None:
        self._rows = np.empty((FIRST_CAPACITY, SMPL22.num_joints, 3), dtype=np.float32)
        self._used = 0

    def add(self, positions: Float32[np.ndarray, "_frames joints 3"]) -> None:
        """Copy one motion to the end."""
        needed = self._used + len(positions)
        if needed > len(self._rows):
            # `resize` moves memory pages instead of copying them.
            self._rows.resize((max(needed, 2 * len(self._rows)), *self._rows.shape[1:]), refcheck=False)
        self._rows[self._used : needed] = positions
        self._used = needed

    def finish(self) -> Float32[np.ndarray, "rows joints 3"]:
        """All of them, and nothing is left here."""
        rows, used = self._rows, self._used
        self._rows, self._used = np.empty((0, SMPL22.num_joints, 3), dtype=np.float32), 0
        rows.resize((used, *rows.shape[1:]), refcheck=False)
        return rows


class Packer:
    """Collects motions with their framerates and texts."""

    def __init__(self) -> None:
        self._rows = Rows()
        self._lengths: list[int] = []
        self._fps: list[Fraction] = []
        self._texts: list[SampleText] = []
        self._vectors: list[Float32[np.ndarray, "_frames numbers"]] = []
        self._kit_joints: list[Float32[np.ndarray, "_frames 21 3"]] = []

    def __len__(self) -> int:
        return len(self._lengths)

    def add(
        self,
        positions: Float32[np.ndarray, "_frames joints 3"],
        fps: Fraction,
        text: SampleText,
        vectors: Float32[np.ndarray, "_frames numbers"] | None = None,
        kit_joints: Float32[np.ndarray, "_frames 21 3"] | None = None,
    ) -> None:
        """Copy one motion to the end; its pose vectors and KIT joints, where there are any, are kept as they are."""
        self._rows.add(positions)
        self._lengths.append(len(positions))
        self._fps.append(fps)
        self._texts.append(text)
        if vectors is not None:
            self._vectors.append(vectors)
        if kit_joints is not None:
            self._kit_joints.append(kit_joints)

    def finish(self, name: str, left_out: Sequence[FormatError], remarks: Sequence[str]) -> SampleFolder:
        """Everything that was added; the packer is empty afterwards."""
        return SampleFolder(
            name,
            self._rows.finish(),
            np.array(self._lengths, dtype=np.int64),
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
