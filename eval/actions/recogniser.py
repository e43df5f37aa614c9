"""The interface of an action recogniser, used by accuracy and the action task's FID, Diversity and MultiModality."""

from dataclasses import dataclass
from fractions import Fraction
from typing import Protocol, runtime_checkable

import numpy as np

from eval.sets.sets import SampleSet
from motionkit.core.errors import MotionkitError
from motionkit.core.shapes import Float64, Int64


@dataclass(frozen=True, eq=False)
class Recognition:
    """A recogniser's output: features and a score per action for each motion, in the set's order."""

    features: Float64[np.ndarray, "sequences features"]
    scores: Float64[np.ndarray, "sequences actions"]


@runtime_checkable
class ActionRecogniser(Protocol):
    """Classifies motions by action; a motion's row depends on that motion alone."""

    @property
    def name(self) -> str:
        """Name for tables."""
        ...

    @property
    def fingerprint(self) -> str:
        """Hash of everything that the numbers depend on: definition, weights, settings."""
        ...

    @property
    def fps(self) -> Fraction | None:
        """The only framerate that it accepts; None for any."""
        ...

    @property
    def actions(self) -> tuple[str, ...]:
        """Names of the actions, in the order of the scores."""
        ...

    def recognise(self, samples: SampleSet) -> Recognition:
        """Features and scores of every sequence. Raises `MotionkitError` for an unsupported framerate or skeleton."""
        ...


def check_fps(recogniser: ActionRecogniser, samples: SampleSet) -> None:
    """Raise `MotionkitError` for motions at a framerate that the recogniser does not accept."""
    if recogniser.fps not in (None, samples.fps):
        raise MotionkitError(
            f"{samples.name}: motions at {samples.fps} fps, but the recogniser {recogniser.name!r} was trained at "
            f"{recogniser.fps} fps only; resample them first"
        )


def clip_frames(num_frames: int, clip_length: int) -> Int64[np.ndarray, "clip"]:
    """Frame indices of a motion's clip: its middle, or all frames padded with the last one.

    The published evaluations take a random stretch of a longer motion; the middle is deterministic.
    Sources: action-to-motion, dataProcessing/dataset.py; ACTOR, src/datasets/dataset.py.
    """
    first = max(0, num_frames - clip_length) // 2
    return np.minimum(first + np.arange(clip_length), num_frames - 1)


def clip_rows(samples: SampleSet, clip_length: int) -> Int64[np.ndarray, "sequences clip"]:
    """Rows of `samples` that make each sequence's clip; see `clip_frames`."""
    return np.stack(
        [
            int(start) + clip_frames(int(length), clip_length)
            for start, length in zip(samples.sequences.start_row, samples.sequences.num_frames, strict=True)
        ]
    )
