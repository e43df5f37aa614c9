"""Clips of one length out of motions of any length, as action recognisers want them."""

import numpy as np
from jaxtyping import Float32, Int64

from eval.samples.sets import SampleSet


def clip_frames(num_frames: int, clip_length: int) -> Int64[np.ndarray, "clip"]:
    """Which frames of a motion make its clip: the middle ones, or all of them and then the last one again and again.

    The published evaluations take a random stretch of a longer motion; the middle makes a motion's numbers its own.
    Sources: action-to-motion, dataProcessing/dataset.py; ACTOR, src/datasets/dataset.py.
    """
    first = max(0, num_frames - clip_length) // 2
    return np.minimum(first + np.arange(clip_length), num_frames - 1)


def middle(positions: Float32[np.ndarray, "frames joints 3"], longest: int) -> Float32[np.ndarray, "clip joints 3"]:
    """The middle `longest` frames of a motion, all of a shorter one."""
    first = max(0, len(positions) - longest) // 2
    return positions[first : first + longest]


def clip_rows(samples: SampleSet, clip_length: int) -> Int64[np.ndarray, "sequences clip"]:
    """Rows of `samples` that make each sequence's clip; see `clip_frames`."""
    return np.stack(
        [
            int(start) + clip_frames(int(length), clip_length)
            for start, length in zip(samples.start_row, samples.num_frames, strict=True)
        ]
    )
