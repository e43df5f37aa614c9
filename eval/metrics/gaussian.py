"""Distances between distributions of features: fitted Gaussians, the Fréchet distance, the kernel distance."""

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from eval.metrics.checks import checked_features
from eval.metrics.metric import Arguments, Metric
from motionkit.core.shapes import Float, Float64


@dataclass(frozen=True, eq=False)
class Gaussian:
    """Mean, N − 1 covariance and number of samples of a feature set, float64."""

    mean: Float64[np.ndarray, "features"]
    covariance: Float64[np.ndarray, "features features"]
    num_samples: int

    def __post_init__(self) -> None:
        if self.covariance.shape != (self.mean.size, self.mean.size):
            raise ValueError(f"covariance is {self.covariance.shape}, but the mean has {self.mean.size} numbers")
        if self.num_samples < 2:
            raise ValueError(f"a covariance needs at least 2 samples, not {self.num_samples}")
        if not (np.isfinite(self.mean).all() and np.isfinite(self.covariance).all()):
            raise ValueError("mean or covariance holds NaN or infinity; a distance from it would mean nothing")

    @cached_property
    def factor(self) -> Float64[np.ndarray, "features features"]:
        """L with L·Lᵀ = covariance, from its eigenvalues; those negative by rounding are set to zero."""
        eigenvalues, eigenvectors = np.linalg.eigh(self.covariance)
        return np.asarray(eigenvectors * np.sqrt(np.maximum(eigenvalues, 0.0)), dtype=np.float64)

    def part(self, features: slice) -> "Gaussian":
        """The Gaussian of some of the features; cached, with its factor."""
        key = (features.start, features.stop, features.step)
        if key not in self._parts:
            self._parts[key] = Gaussian(self.mean[features], self.covariance[features, features], self.num_samples)
        return self._parts[key]

    @cached_property
    def _parts(self) -> dict[tuple[int | None, ...], "Gaussian"]:
        return {}


@dataclass(frozen=True, eq=False)
class FeatureSums:
    """Sufficient statistics of a Gaussian: number of samples, mean, Σ(x − mean)(x − mean)ᵀ. The default has no samples.

    Sums are about the mean: raw second moments lose all digits of a small spread far from zero.
    """

    num_samples: int = 0
    mean: Float64[np.ndarray, "features"] | None = None
    scatter: Float64[np.ndarray, "features features"] | None = None

    def merged(self, other: "FeatureSums") -> "FeatureSums":
        """Sums of the union of both disjoint sample sets (Chan, Golub & LeVeque 1983)."""
        if self.mean is None or self.scatter is None:
            return other
        if other.mean is None or other.scatter is None:
            return self
        if self.mean.shape != other.mean.shape:
            raise ValueError(f"sums of {self.mean.size} and of {other.mean.size} features cannot be merged")
        total = self.num_samples + other.num_samples
        shift = other.mean - self.mean
        cross = np.outer(shift, shift) * (self.num_samples * other.num_samples / total)
        mean = self.mean + shift * (other.num_samples / total)
        return FeatureSums(total, mean, self.scatter + other.scatter + cross)

    @property
    def gaussian(self) -> Gaussian:
        """The Gaussian of all samples; raises `ValueError` for fewer than 2."""
        if self.mean is None or self.scatter is None or self.num_samples < 2:
            raise ValueError(f"a covariance needs at least 2 samples, not {self.num_samples}")
        return Gaussian(self.mean, self.scatter / (self.num_samples - 1), self.num_samples)


def feature_sums(features: Float[np.ndarray, "samples features"]) -> FeatureSums:
    """Sums of one batch, in float64. Raises `ValueError` for no samples, NaN or infinity."""
    values = checked_features(features, "features", minimum=1)
    mean = values.mean(axis=0)
    centred = values - mean
    return FeatureSums(len(values), mean, centred.T @ centred)


def fit_gaussian(features: Float[np.ndarray, "samples features"]) -> Gaussian:
    """Fit a Gaussian in float64. Raises `ValueError` for NaN, infinity or fewer than 2 samples."""
    return feature_sums(checked_features(features, "features", minimum=2)).gaussian


def frechet_distance(a: Gaussian, b: Gaussian) -> float:
    """‖μ₁ − μ₂‖² + Tr(Σ₁ + Σ₂ − 2(Σ₁Σ₂)^½): the squared 2-Wasserstein distance of two Gaussians; symmetric.

    With Σᵢ = LᵢLᵢᵀ the trace of (Σ₁Σ₂)^½ is the sum of the singular values of L₁ᵀL₂: no matrix square root is taken
    and singular covariances are no special case. With no more samples than features the distance is still that of the
    two fitted (degenerate) Gaussians, but it says little about the distributions: its bias grows as features / N, so
    quote N beside it. Source: Dowson & Landau 1982; Heusel et al. 2017.
    """
    if a.mean.shape != b.mean.shape:
        raise ValueError(f"the two sets have {a.mean.size} and {b.mean.size} features")
    cross = np.linalg.svd(a.factor.T @ b.factor, compute_uv=False).sum()
    spread = np.trace(a.covariance) + np.trace(b.covariance) - 2.0 * cross
    shift = a.mean - b.mean
    return max(0.0, float(shift @ shift + spread))


def quick_frechet_distance(a: Gaussian, b: Gaussian) -> float:
    """`frechet_distance` to 1e-7 of the variances, by the eigenvalues of L₁ᵀΣ₂L₁: caches L₁ for many b and one a."""
    if a.mean.shape != b.mean.shape:
        raise ValueError(f"the two sets have {a.mean.size} and {b.mean.size} features")
    eigenvalues = np.linalg.eigvalsh(a.factor.T @ b.covariance @ a.factor)
    spread = np.trace(a.covariance) + np.trace(b.covariance) - 2.0 * np.sqrt(np.maximum(eigenvalues, 0.0)).sum()
    shift = a.mean - b.mean
    return max(0.0, float(shift @ shift + spread))


def fid(real: Float[np.ndarray, "n features"], generated: Float[np.ndarray, "m features"]) -> float:
    """Fréchet distance between the Gaussians of two feature sets, in float64; see `frechet_distance`."""
    # On a busy machine the BLAS threads wait for one another: ten times slower than a single one.
    with threadpool_limits(1, "blas"):
        return frechet_distance(fit_gaussian(real), fit_gaussian(generated))


@dataclass(frozen=True)
class Extrapolation:
    """FID at several N and the line through them over 1/N: `limit` is its value at 1/N = 0, `slope` its slope."""

    limit: float
    slope: float
    sizes: tuple[int, ...]
    values: tuple[float, ...]


def fid_infinity(
    real: Float[np.ndarray, "n features"],
    generated: Float[np.ndarray, "m features"],
    rng: np.random.Generator,
    num_points: int = 8,
    smallest_fraction: float = 0.25,
) -> Extrapolation:
    """FID extrapolated to infinitely many samples, by a least-squares line over 1/N (Chong & Forsyth 2020, §4).

    Both sides are thinned to the same N (the paper thins the generated side alone, its real statistics being fixed), so
    that the limit is free of both sides' bias to first order; subsets are prefixes of one random order, N evenly spaced
    from `smallest_fraction` of the smaller set to all of it. Raises `ValueError` for NaN or infinity, and if the
    smallest subset has no more samples than features: FID of singular covariances is not linear in 1/N, its
    extrapolation far off (two draws of 256 from one 128-dimensional normal distribution: 7.7 instead of 0).
    """
    real = checked_features(real, "real", minimum=2)
    generated = checked_features(generated, "generated", minimum=2)
    largest, features = min(len(real), len(generated)), real.shape[1]
    sizes = np.unique(np.linspace(smallest_fraction * largest, largest, num_points).astype(np.int64))
    if sizes[0] < 2 or len(sizes) < 2 or np.diff(sizes).min() < 2 or sizes[0] <= features:
        raise ValueError(
            f"{largest} samples of {features} features are too few to extrapolate from: it takes more than "
            f"{math.ceil((features + 1) / smallest_fraction) - 1}"
        )
    real_gaussians = _prefix_gaussians(real[rng.permutation(len(real))[:largest]], sizes)
    generated_gaussians = _prefix_gaussians(generated[rng.permutation(len(generated))[:largest]], sizes)
    values = np.array([frechet_distance(a, b) for a, b in zip(real_gaussians, generated_gaussians, strict=True)])
    inverse = 1.0 / sizes
    centred = inverse - inverse.mean()
    slope = float(centred @ values / (centred @ centred))
    limit = float(values.mean() - slope * inverse.mean())
    return Extrapolation(limit, slope, tuple(sizes.tolist()), tuple(values.tolist()))


def _prefix_gaussians(features: Float[np.ndarray, "samples features"], sizes: npt.NDArray[np.int64]) -> list[Gaussian]:
    """Gaussians of the first `sizes[i]` rows; every row is visited once."""
    result: list[Gaussian] = []
    total = FeatureSums()
    for start, stop in pairwise((0, *sizes.tolist())):
        total = total.merged(feature_sums(features[start:stop]))
        result.append(total.gaussian)
    return result


BLOCK_ROWS = 512
MAX_ROUNDING = 1e-3
"""Largest rounding error of a kernel's value, relative to its value on centred features."""


def kid(real: Float[np.ndarray, "n features"], generated: Float[np.ndarray, "m features"]) -> float:
    """Unbiased squared MMD with k(x, y) = (x·y / features + 1)³; may be negative; expectation 0 for equal sets.

    Published figures average over random subsets of 1,000; the U-statistic over whole sets, used here, has the same
    expectation and less variance. Symmetric. The kernel depends on the origin: raises `ValueError` for features so
    far from it, relative to their spread, that rounding hides their differences. Source: Bińkowski et al. 2018, §4.
    """
    x = checked_features(real, "real", minimum=2)
    y = checked_features(generated, "generated", minimum=2)
    n, m = len(x), len(y)
    squared_mean, variance = np.square(x.mean(axis=0)).mean(), x.var(axis=0).mean()
    if np.finfo(np.float64).eps * (squared_mean + variance + 1.0) ** 3 > MAX_ROUNDING * (variance + 1.0) ** 3:
        raise ValueError(
            f"real: the features' mean is {math.sqrt(squared_mean):.3g}, their deviation {math.sqrt(variance):.3g}, so "
            "differences of the cubic kernel are rounding errors: subtract the real set's mean from both sets"
        )
    within_x = (_kernel_sum(x, x) - _diagonal_sum(x)) / (n * (n - 1))
    within_y = (_kernel_sum(y, y) - _diagonal_sum(y)) / (m * (m - 1))
    return within_x + within_y - 2.0 * _kernel_sum(x, y) / (n * m)


def _kernel_sum(x: Float64[np.ndarray, "n features"], y: Float64[np.ndarray, "m features"]) -> float:
    """Σᵢⱼ k(xᵢ, yⱼ), in blocks of rows so that the full matrix is never held."""
    total = 0.0
    for start in range(0, len(x), BLOCK_ROWS):
        base = x[start : start + BLOCK_ROWS] @ y.T
        base /= x.shape[1]
        base += 1.0
        total += float(np.vdot(base * base, base))
    return total


def _diagonal_sum(x: Float64[np.ndarray, "n features"]) -> float:
    base = np.einsum("nf,nf->n", x, x) / x.shape[1] + 1.0
    return float((base**3).sum())


_SETS: Arguments = "real, generated"
METRICS = (
    Metric("fid", "FID", "", False, "Heusel et al. 2017", _SETS, fid),
    Metric("fid_train", "FID (training set)", "", False, "ACTOR (Petrovich et al. 2021)", _SETS, fid),
    Metric("fid_test", "FID (test set)", "", False, "ACTOR (Petrovich et al. 2021)", _SETS, fid),
    Metric("fid_infinity", "FID∞", "", False, "Chong & Forsyth 2020", _SETS, fid_infinity),
    Metric("kid", "KID", "", False, "Bińkowski et al. 2018", _SETS, kid),
)
