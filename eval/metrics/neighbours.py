"""Nearest neighbours among features: precision, recall, density and coverage, and the nearest training sample."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Float64

from eval.metrics.checks import checked_features
from eval.metrics.metric import Metric

BLOCK_ROWS = 512


@dataclass(frozen=True)
class Prdc:
    """Precision, density: how realistic the generated set is; recall, coverage: how much of the real set it holds."""

    precision: float
    recall: float
    density: float
    coverage: float


def prdc(
    real: Float[np.ndarray, "n features"], generated: Float[np.ndarray, "m features"], num_neighbours: int = 5
) -> Prdc:
    """Precision and recall (Kynkäänniemi et al. 2019), density and coverage (Naeem et al. 2020), not symmetric.

    A point's ball reaches to its k-th neighbour in its own set, itself not counted; a point on the boundary is outside.
    Raises `ValueError` for NaN, sets of no more than k samples, or a real set whose rows are all the same.
    """
    x = checked_features(real, "real", minimum=num_neighbours + 1)
    y = checked_features(generated, "generated", minimum=num_neighbours + 1)
    if (x == x[0]).all():
        raise ValueError("real: all rows are the same, so no sample has a neighbourhood to fall into")
    real_radii = _squared_radii(x, num_neighbours)
    generated_radii = _squared_radii(y, num_neighbours)
    balls_holding = np.zeros(len(y))
    recalled = covered = 0
    for start in range(0, len(x), BLOCK_ROWS):
        rows = slice(start, start + BLOCK_ROWS)
        distances = _squared_distances(x[rows], y)
        balls_holding += (distances < real_radii[rows, None]).sum(axis=0)
        recalled += int((distances < generated_radii).any(axis=1).sum())
        covered += int((distances.min(axis=1) < real_radii[rows]).sum())
    return Prdc(
        precision=float((balls_holding > 0).mean()),
        recall=recalled / len(x),
        density=float(balls_holding.mean()) / num_neighbours,
        coverage=covered / len(x),
    )


PRECISION = Metric("precision", "Precision", "", True, "Kynkäänniemi et al. 2019", "real, generated", prdc)
RECALL = Metric("recall", "Recall", "", True, "Kynkäänniemi et al. 2019", "real, generated", prdc)
DENSITY = Metric("density", "Density", "", True, "Naeem et al. 2020", "real, generated", prdc)
COVERAGE = Metric("coverage", "Coverage", "", True, "Naeem et al. 2020", "real, generated", prdc)


def _squared_distances(
    x: Float64[np.ndarray, "n features"], y: Float64[np.ndarray, "m features"]
) -> Float64[np.ndarray, "n m"]:
    products: Float64[np.ndarray, "n m"] = x @ y.T
    products *= -2.0
    products += np.einsum("nf,nf->n", x, x)[:, None]
    products += np.einsum("nf,nf->n", y, y)
    np.maximum(products, 0.0, out=products)
    return products


def _squared_radii(x: Float64[np.ndarray, "n features"], num_neighbours: int) -> Float64[np.ndarray, "n"]:
    """Squared distance of every point to its k-th neighbour in the same set."""
    radii = np.empty(len(x))
    for start in range(0, len(x), BLOCK_ROWS):
        distances = _squared_distances(x[start : start + BLOCK_ROWS], x)
        rows = np.arange(len(distances))
        distances[rows, start + rows] = np.inf
        radii[start : start + len(rows)] = np.partition(distances, num_neighbours - 1, axis=1)[:, num_neighbours - 1]
    return radii


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
