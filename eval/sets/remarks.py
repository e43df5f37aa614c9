"""What a reader has to know about sets that can be scored, but whose scores do not mean what they seem to."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float32

from eval.sets.sets import SampleSet

SAME_METRES = 1e-5
STILL_METRES = 1e-6


def set_remarks(real: SampleSet, rows: Mapping[str, SampleSet]) -> list[str]:
    """One sentence for each row that holds sequences of the real set, or in which nothing moves."""
    remarks = []
    for name, samples in rows.items():
        copies = _num_copies(real, samples)
        if copies:
            remarks.append(
                f"{name}, {real.fps} fps: {copies} of {samples.num_sequences} sequences are copies of sequences of "
                f"{real.name}; a set of nothing else scores like independent draws (P1), which says nothing of a model"
            )
        if _is_still(samples):
            remarks.append(
                f"{name}, {real.fps} fps: nothing moves in any of the {samples.num_sequences} sequences; features of "
                "speed and acceleration are constant, and their part of the score is the real set's own spread"
            )
    return remarks


def _num_copies(real: SampleSet, samples: SampleSet) -> int:
    """How many sequences are some sequence of the real set, to rounding."""
    known: dict[int, list[Float32[np.ndarray, "_ joints 3"]]] = {}
    for sequence in real.sequences:
        known.setdefault(len(sequence), []).append(sequence)
    return sum(
        any(_same(sequence[0], other[0]) and _same(sequence, other) for other in known.get(len(sequence), ()))
        for sequence in samples.sequences
    )


def _same(a: Float32[np.ndarray, "*shape"], b: Float32[np.ndarray, "*shape"]) -> bool:
    return bool(np.abs(a - b).max() < SAME_METRES)


def _is_still(samples: SampleSet) -> bool:
    """Whether no joint moves from any frame to the next of the same sequence."""
    positions = samples.sequences.values
    steps = np.abs(np.diff(positions, axis=0)).reshape(max(len(positions) - 1, 0), -1)
    inside = np.ones(len(steps), dtype=bool)
    inside[samples.sequences.start_row[1:] - 1] = False
    return bool((steps[inside] < STILL_METRES).all())
