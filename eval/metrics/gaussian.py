"""Gaussians fitted to features: whole, or from sums that batches and ranks add up."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Float64

from eval.metrics.checks import checked_features


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
        """L with L·Lᵀ = covariance, from its eigenvalues; those that rounding made negative count as zero."""
        eigenvalues, eigenvectors = np.linalg.eigh(self.covariance)
        return np.asarray(eigenvectors * np.sqrt(np.maximum(eigenvalues, 0.0)), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class FeatureSums:
    """What a Gaussian is made of: number of samples, their mean, Σ(x − mean)(x − mean)ᵀ. Without arguments: no samples.

    Sums about the mean, not raw second moments: those lose all digits of a small spread far from zero.
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
