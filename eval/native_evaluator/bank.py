"""Real motion resampled to each framerate that a learned evaluator is trained at, and random clips of it.

As in clip-fid/1, sequences with a native rate below a framerate are excluded, and those above are downsampled by the
same anti-aliased resampling as the metric's real set. A bank is bounded in seconds, so a store of any size can be
trained on.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from eval.sets.sets import Ragged
from motionkit.core.errors import UsageError
from motionkit.core.motion import Caption
from motionkit.core.shapes import Float64, Int64
from motionkit.fields.resample import resample_positions


@dataclass(frozen=True, eq=False)
class Takes:
    """Sequences of 22 joints at their native rates.

    `captions` holds any number of sentences per sequence, with their seconds from its start.
    """

    sequences: Ragged
    fps: tuple[Fraction, ...]
    captions: tuple[tuple[Caption, ...], ...]

    def duration_seconds(self) -> Float64[np.ndarray, "sequences"]:
        """Seconds of each sequence."""
        lengths = self.sequences.num_frames
        return np.array([int(frames) / float(fps) for frames, fps in zip(lengths, self.fps, strict=True)])


@dataclass(frozen=True, eq=False)
class DrawnClips:
    """Clips, the take of each, and the time of each clip's middle in seconds from the take's start."""

    positions: Float64[np.ndarray, "clips poses 22 3"]
    take: Int64[np.ndarray, "clips"]
    centre_seconds: Float64[np.ndarray, "clips"]


@dataclass(frozen=True, eq=False)
class ClipBank:
    """Sequences at one framerate; `sequence_index` is the index of each in the takes."""

    fps: Fraction
    sequences: Ragged
    sequence_index: Int64[np.ndarray, "sequences"]

    def draw(self, rng: np.random.Generator, num_clips: int, num_poses: int, margin: int = 0) -> DrawnClips:
        """Random clips of `num_poses` poses, with `margin` more on either side.

        Every position of the clip inside a sequence is equally likely. Margins beyond a sequence are filled by point
        reflection about its end pose. Raises `ValueError` if no sequence is long enough.
        """
        places = np.maximum(self.sequences.num_frames - num_poses + 1, 0)
        total = np.cumsum(places)
        if total[-1] == 0:
            raise ValueError(f"no sequence in this bank has {num_poses} poses at {self.fps} fps")
        place = rng.integers(total[-1], size=num_clips)
        sequence = np.searchsorted(total, place, side="right")
        start = place - (total[sequence] - places[sequence])
        frame = start[:, None] + np.arange(-margin, num_poses + margin)
        middle = (start + (num_poses - 1) / 2) / float(self.fps)
        return DrawnClips(self._gather(sequence, frame), self.sequence_index[sequence], middle)

    def _gather(
        self, sequence: Int64[np.ndarray, "clips"], frame: Int64[np.ndarray, "clips poses"]
    ) -> Float64[np.ndarray, "clips poses 22 3"]:
        positions = self.sequences.values
        last = (self.sequences.num_frames[sequence] - 1)[:, None]
        first_row = self.sequences.start_row[sequence][:, None]
        end = np.clip(frame, 0, last)
        mirrored = np.clip(2 * end - frame, 0, last)
        ends = positions[first_row + end].astype(np.float64)
        inside = (frame == end)[..., None, None]
        clips: Float64[np.ndarray, "clips poses 22 3"] = np.where(
            inside, ends, 2 * ends - positions[first_row + mirrored]
        )
        return clips


def build_bank(takes: Takes, fps: Fraction, max_seconds: float, min_poses: int, rng: np.random.Generator) -> ClipBank:
    """A bank at one framerate from sequences of at least that rate, in random order up to `max_seconds`.

    Raises `UsageError` if no sequence reaches the framerate with `min_poses` poses.
    """
    seconds = takes.duration_seconds()
    chosen = [
        index
        for index in range(len(takes.fps))
        if takes.fps[index] >= fps and seconds[index] * float(fps) >= min_poses + 1
    ]
    if not chosen:
        raise UsageError(f"no sequence has {min_poses} poses at {fps} fps or more")
    order = rng.permutation(np.array(chosen))
    within = np.cumsum(seconds[order]) - seconds[order] < max_seconds
    kept = np.sort(order[within])
    parts = [resample_positions(np.asarray(takes.sequences[i]), takes.fps[int(i)], fps) for i in kept]
    return ClipBank(fps, Ragged.of(parts), kept.astype(np.int64))


def build_banks(
    takes: Takes, framerates: Sequence[Fraction], max_seconds: float, min_poses: int, seed: int
) -> tuple[ClipBank, ...]:
    """One bank for each framerate that some sequence reaches; raises `UsageError` if none does."""
    highest = max(takes.fps, default=Fraction(0))
    reached = [fps for fps in framerates if fps <= highest]
    if not reached:
        raise UsageError(
            f"the store's highest framerate is {float(highest):g}; the evaluator is trained at "
            f"{float(min(framerates)):g} up: name lower ones with --set training.framerates={float(highest):g}"
        )
    return tuple(
        build_bank(takes, fps, max_seconds, min_poses, np.random.default_rng((seed, fps.numerator, fps.denominator)))
        for fps in reached
    )
