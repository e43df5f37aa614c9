"""Remarks on sets of motions: real motions among them, nothing that moves, fewer than the reference."""

from collections.abc import Mapping

import numpy as np
from threadpoolctl import threadpool_limits

from eval.metrics.gaussian import fit_gaussian, frechet_distance
from eval.sets.sets import SampleSet
from motionkit.core.shapes import Float, Float32

CHOICES = 10
SAME = 1e-6
"""Fraction of the real features' spread: embeddings of one motion differ by far less, those of two by far more."""

Features = Float[np.ndarray, "_samples features"]


def size_remarks(real: Features, reference: Features, other: Features, seed: int) -> list[str]:
    """Remarks on motions that are real ones, and on the FID of sets smaller than the reference.

    `reference` are those of the real motions that FID compares with. The second remark has the FID of equally many
    random motions of the reference against all of it: its mean, and the range of ten draws.
    """
    remarks = []
    copies = num_copies(real, other)
    if copies:
        remarks.append(
            f"{copies:,} of {len(other):,} motions are real motions of this set, which says nothing of a model"
        )
    if len(other) < len(reference):
        rng = np.random.default_rng((seed, 9))
        with threadpool_limits(1, "blas"):
            whole = fit_gaussian(reference)
            chosen = [rng.choice(len(reference), size=len(other), replace=False) for _ in range(CHOICES)]
            fids = [frechet_distance(whole, fit_gaussian(reference[rows])) for rows in chosen]
        remarks.append(
            f"as many random real motions ({len(other):,}) have an FID of {np.mean(fids):.3g} from all "
            f"({min(fids):.3g} to {max(fids):.3g} in {CHOICES} choices)"
        )
    return remarks


def num_copies(real: Features, other: Features) -> int:
    """Number of rows that equal a row of the real features, up to rounding."""
    tolerance = SAME * float(real.std())
    order = np.argsort(real[:, 0], kind="stable")
    first = real[order, 0]
    low, high = (np.searchsorted(first, other[:, 0] + sign * tolerance) for sign in (-1, 1))
    return sum(
        bool((np.abs(real[order[start:stop]] - row) <= tolerance).all(axis=1).any())
        for row, start, stop in zip(other, low.tolist(), high.tolist(), strict=True)
    )


SAME_METRES = 1e-5
STILL_METRES = 1e-6


def set_remarks(real: SampleSet, rows: Mapping[str, SampleSet]) -> list[str]:
    """One remark for each row that holds sequences of the real set, or in which nothing moves."""
    remarks = []
    for name, samples in rows.items():
        copies = _num_copied_sequences(real, samples)
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


def _num_copied_sequences(real: SampleSet, samples: SampleSet) -> int:
    """Number of sequences that equal a sequence of the real set, up to rounding."""
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
