"""The nearest row of a large set to each of some queries, in bounded memory."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float, Float32


def nearest_rows(
    queries: Float[np.ndarray, "queries features"], blocks: Iterable[Float[np.ndarray, "_ features"]]
) -> Float32[np.ndarray, "queries features"]:
    """The row of any block that has the least Euclidean distance to each query (the first among equals).

    Blocks are looked at one after another by matrix products in float32, so two candidates whose squared distances
    differ by less than 1e-6 of the larger squared length may change places. Raises `ValueError` where there is no row.
    """
    wanted = queries.astype(np.float32)
    best = np.full(len(wanted), np.inf, dtype=np.float32)
    found = np.zeros_like(wanted)
    for block in blocks:
        if not len(block):
            continue
        rows = block.astype(np.float32, copy=False)
        # ‖q − r‖² − ‖q‖²: the query's own length doesn't change which row is nearest.
        distances = wanted @ rows.T
        distances *= -2.0
        distances += np.einsum("rf,rf->r", rows, rows)
        nearest = distances.argmin(axis=1)
        closest = distances[np.arange(len(wanted)), nearest]
        better = closest < best
        found[better] = rows[nearest[better]]
        best[better] = closest[better]
    if np.isinf(best).any():
        raise ValueError("there is nothing to look for neighbours among")
    return found
