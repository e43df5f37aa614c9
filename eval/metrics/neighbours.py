"""Nearest neighbours among features: precision, recall, density and coverage."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eval.metrics.checks import checked_features
from eval.metrics.metric import Arguments, Metric
from motionkit.core.shapes import Bool, Float, Float64

BLOCK_ROWS = 512
BLOCK_PAIRS = 1 << 16


@dataclass(frozen=True)
class Prdc:
    """Precision, density: how realistic the generated set is; recall, coverage: how much of the real set it holds."""

    precision: float
    recall: float
    density: float
    coverage: float


class RealManifold:
    """The balls of a real set, with which generated sets are compared; raises as `prdc`."""

    def __init__(self, real: Float[np.ndarray, "n features"], num_neighbours: int = 5) -> None:
        x = checked_features(real, "real", minimum=num_neighbours + 1)
        if (x == x[0]).all():
            raise ValueError("real: all rows are the same, so no sample has a neighbourhood to fall into")
        self.num_neighbours, self._centre = num_neighbours, x.mean(axis=0)
        x = x - self._centre
        # Neighbours do not depend on the scale, squares of 1e±200 are not finite numbers. Powers of two round nothing.
        self._exponent = int(np.frexp(np.abs(x).max())[1])
        self._points = _Points.of(np.ldexp(x, -self._exponent))
        self._radii = _squared_radii(self._points, num_neighbours)

    def compare(self, generated: Float[np.ndarray, "m features"]) -> Prdc:
        """Precision, recall, density and coverage of a generated set."""
        y = checked_features(generated, "generated", minimum=self.num_neighbours + 1) - self._centre
        points = _Points.of(np.ldexp(y, -self._exponent))
        radii = _squared_radii(points, self.num_neighbours)
        balls_holding, num_real = np.zeros(len(y)), len(self._radii)
        recalled = covered = 0
        for start in range(0, num_real, BLOCK_ROWS):
            rows = slice(start, start + BLOCK_ROWS)
            distances = _SquaredDistances.between(self._points.at(rows), points)
            in_real_balls = distances.below_by_row(self._radii[rows])
            balls_holding += in_real_balls.sum(axis=0)
            recalled += int(distances.below_by_column(radii).any(axis=1).sum())
            covered += int(in_real_balls.any(axis=1).sum())
        return Prdc(
            precision=float((balls_holding > 0).mean()),
            recall=recalled / num_real,
            density=float(balls_holding.mean()) / self.num_neighbours,
            coverage=covered / num_real,
        )


def prdc(
    real: Float[np.ndarray, "n features"], generated: Float[np.ndarray, "m features"], num_neighbours: int = 5
) -> Prdc:
    """Precision and recall (Kynkäänniemi et al. 2019), density and coverage (Naeem et al. 2020), not symmetric.

    A point's ball reaches to its k-th neighbour in its own set, excluding itself; the boundary is outside. Raises
    `ValueError` for NaN, sets of no more than k samples, or a real set with identical rows.
    """
    return RealManifold(real, num_neighbours).compare(generated)


@dataclass(frozen=True)
class _Points:
    """Rows about a common centre, and their squared lengths."""

    rows: Float64[np.ndarray, "n features"]
    lengths: Float64[np.ndarray, "n"]

    @classmethod
    def of(cls, rows: Float64[np.ndarray, "n features"]) -> "_Points":
        return cls(rows, np.einsum("nf,nf->n", rows, rows))

    def at(self, rows: slice) -> "_Points":
        return _Points(self.rows[rows], self.lengths[rows])


@dataclass(frozen=True)
class _SquaredDistances:
    """|a|² + |b|² − 2ab of all pairs, by one matrix product.

    Centring keeps |a|² as small as the spread of the points; a comparison within rounding error is repeated with the
    exact sum of squared differences.
    """

    x: _Points
    y: _Points
    values: Float64[np.ndarray, "n m"]

    @classmethod
    def between(cls, x: _Points, y: _Points) -> "_SquaredDistances":
        values: Float64[np.ndarray, "n m"] = x.rows @ y.rows.T
        values *= -2.0
        values += x.lengths[:, None]
        values += y.lengths
        return cls(x, y, values)

    def exact(self, rows: npt.NDArray[np.int64], columns: npt.NDArray[np.int64]) -> Float64[np.ndarray, "pairs"]:
        """Squared distances of single pairs."""
        found = np.empty(len(rows))
        for start in range(0, len(rows), BLOCK_PAIRS):
            some = slice(start, start + BLOCK_PAIRS)
            differences = self.x.rows[rows[some]] - self.y.rows[columns[some]]
            found[some] = np.einsum("kf,kf->k", differences, differences)
        return found

    def below_by_row(self, limits: Float64[np.ndarray, "n"]) -> Bool[np.ndarray, "n m"]:
        """Which pairs are nearer than their row's limit, a squared distance."""
        return self._below(limits[:, None], self.x.lengths[:, None] + self.y.lengths.max())

    def below_by_column(self, limits: Float64[np.ndarray, "m"]) -> Bool[np.ndarray, "n m"]:
        """Which pairs are nearer than their column's limit, a squared distance."""
        return self._below(limits[None], self.x.lengths.max() + self.y.lengths[None])

    def _below(
        self, limits: Float64[np.ndarray, "#n #m"], sums: Float64[np.ndarray, "#n #m"]
    ) -> Bool[np.ndarray, "n m"]:
        errors = (self.x.rows.shape[1] + 4) * np.finfo(np.float64).eps * sums
        found: Bool[np.ndarray, "n m"] = self.values < limits - errors
        rows, columns = np.nonzero(found != (self.values <= limits + errors))
        found[rows, columns] = self.exact(rows, columns) < np.broadcast_to(limits, found.shape)[rows, columns]
        return found


def _squared_radii(points: _Points, num_neighbours: int) -> Float64[np.ndarray, "n"]:
    """Squared distance of every point to its k-th neighbour in the same set."""
    radii = np.empty(len(points.rows))
    for start in range(0, len(radii), BLOCK_ROWS):
        distances = _SquaredDistances.between(points.at(slice(start, start + BLOCK_ROWS)), points)
        rows = np.arange(len(distances.values))
        distances.values[rows, start + rows] = np.inf
        nearest = np.argpartition(distances.values, num_neighbours - 1, axis=1)[:, :num_neighbours]
        exact = distances.exact(rows.repeat(num_neighbours), nearest.reshape(-1))
        radii[start : start + len(rows)] = exact.reshape(nearest.shape).max(axis=1)
    return radii


_SETS: Arguments = "real, generated"
METRICS = (
    Metric("precision", "Precision", "", True, "Kynkäänniemi et al. 2019", _SETS, prdc),
    Metric("recall", "Recall", "", True, "Kynkäänniemi et al. 2019", _SETS, prdc),
    Metric("density", "Density", "", True, "Naeem et al. 2020", _SETS, prdc),
    Metric("coverage", "Coverage", "", True, "Naeem et al. 2020", _SETS, prdc),
)
