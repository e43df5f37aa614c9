"""What a reader has to know of a set beside its FID: whether it is the real set itself, what its size alone costs."""

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from eval.metrics.frechet import frechet_distance
from eval.metrics.gaussian import fit_gaussian

CHOICES = 10
SAME = 1e-6
"""Of the spread of the real features: embeddings of one motion differ by far less, those of two by far more."""

Features = Float[np.ndarray, "_samples features"]


def size_remarks(real: Features, reference: Features, other: Features, seed: int) -> list[str]:
    """Sentences about motions that are real ones, and about what it costs to be fewer than the reference.

    `reference` are those of the real motions that FID compares with. The second sentence has the FID that as many
    random motions of the reference have from all of it: its mean, and the range of ten choices.
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
    """How many rows are some row of the real features, to rounding."""
    tolerance = SAME * float(real.std())
    order = np.argsort(real[:, 0], kind="stable")
    first = real[order, 0]
    low, high = (np.searchsorted(first, other[:, 0] + sign * tolerance) for sign in (-1, 1))
    return sum(
        bool((np.abs(real[order[start:stop]] - row) <= tolerance).all(axis=1).any())
        for row, start, stop in zip(other, low.tolist(), high.tolist(), strict=True)
    )
