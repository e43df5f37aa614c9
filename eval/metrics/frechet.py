"""Fréchet distance between Gaussians fitted to features (FID), and its extrapolation to infinitely many samples."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from eval.metrics.gaussian import FeatureSums, Gaussian, feature_sums, fit_gaussian


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


def fid(real: Float[np.ndarray, "n features"], generated: Float[np.ndarray, "m features"]) -> float:
    """Fréchet distance between the Gaussians of two feature sets, in float64; see `frechet_distance`."""
    # On a busy machine the linear algebra library's threads wait for one another: ten times slower than one.
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

    Both sides are thinned to the same N (the paper thins the generated side alone, its real statistics being fixed),
    so that the limit is free of both sides' bias to first order; subsets are prefixes of one random order, N evenly
    spaced from `smallest_fraction` of the smaller set to all of it. Raises `ValueError` where the fewest are no more
    than the features: FID of singular covariances is no line over 1/N, and its extrapolation is far off (two draws of
    256 from one 128-dimensional normal distribution: 7.7 instead of 0).
    """
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
