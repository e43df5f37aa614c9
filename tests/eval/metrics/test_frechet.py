"""FID: known answers, three independent references, properties, refusals."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from mpmath import matrix, mp
from torchmetrics.image.fid import FrechetInceptionDistance

from eval.metrics.distributions import (
    FeatureSums,
    Gaussian,
    feature_sums,
    fid,
    fid_infinity,
    fit_gaussian,
    frechet_distance,
)
from tests.helpers.given_features import GivenFeatures


def two_sets(seed: int, num_samples: int = 300, num_features: int = 12) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    mixing = rng.normal(size=(2, num_features, num_features))
    x, y = rng.normal(size=(2, num_samples, num_features))
    return x @ mixing[0], y @ mixing[1] + 0.3


def of_torchmetrics(x: np.ndarray, y: np.ndarray) -> float:
    metric = FrechetInceptionDistance(feature=GivenFeatures(x.shape[1]))
    metric.set_dtype(torch.float64)
    metric.update(torch.from_numpy(x), real=True)
    metric.update(torch.from_numpy(y), real=False)
    return float(metric.compute())


def in_fifty_digits(x: np.ndarray, y: np.ndarray) -> float:
    with mp.workdps(50):
        parts = []
        for samples in (x, y):
            rows = matrix(samples.tolist())
            mean = matrix([sum(rows[i, j] for i in range(rows.rows)) / rows.rows for j in range(rows.cols)]).T
            centred = matrix([[rows[i, j] - mean[j] for j in range(rows.cols)] for i in range(rows.rows)])
            parts.append((mean, centred.T * centred / (rows.rows - 1)))
        (mean_a, a), (mean_b, b) = parts
        eigenvalues = mp.eig(a * b, left=False, right=False)
        cross = sum(mp.sqrt(mp.re(value)) for value in eigenvalues)
        shift = mean_a - mean_b
        trace = sum(a[i, i] + b[i, i] for i in range(a.rows))
        return float(sum(value**2 for value in shift) + trace - 2 * cross)


@pytest.mark.parametrize("seed", range(5))
def test_agrees_with_torchmetrics(seed: int) -> None:
    x, y = two_sets(seed)
    assert fid(x, y) == pytest.approx(of_torchmetrics(x, y), rel=1e-9)


def test_agrees_with_fifty_digits() -> None:
    x, y = two_sets(7, num_samples=20, num_features=4)
    assert fid(x, y) == pytest.approx(in_fifty_digits(x, y), rel=1e-13)


def test_fewer_samples_than_features_is_a_distance_of_degenerate_gaussians() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(2, 6, 40))
    # The same distance inside the span of both sets, where nothing is degenerate beyond what the samples are.
    basis = np.linalg.svd(np.concatenate((x, y)), full_matrices=False)[2]
    assert fid(x, y) == pytest.approx(fid(x @ basis.T, y @ basis.T), rel=1e-10)
    assert fid(x, x) == pytest.approx(0.0, abs=1e-10)


@pytest.mark.parametrize(("num_samples", "distance"), [(4640, 28.6), (1024, 82.0), (500, 172.0)])
def test_bias_of_few_samples(num_samples: int, distance: float) -> None:
    """Against 4,640 draws of the same N(0, I) of 512 numbers: what T2M's, MDM's and a smaller evaluation start from."""
    rng = np.random.default_rng(1)
    real, generated = rng.normal(size=(4640, 512)), rng.normal(size=(num_samples, 512))
    assert fid(real, generated) == pytest.approx(distance, rel=0.01)


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32), scale=st.floats(1e-3, 1e3))
def test_properties(seed: int, scale: float) -> None:
    x, y = two_sets(seed, 60, 5)
    distance = fid(x, y)
    assert distance >= 0
    assert fid(y, x) == pytest.approx(distance, rel=1e-9)
    assert fid(x[::-1], y) == pytest.approx(distance, rel=1e-9)
    assert fid(x * scale, y * scale) == pytest.approx(distance * scale**2, rel=1e-7)
    rotation = np.linalg.qr(np.random.default_rng(seed).normal(size=(5, 5)))[0]
    assert fid(x @ rotation, y @ rotation) == pytest.approx(distance, rel=1e-8)


@pytest.mark.parametrize("cuts", [(1,), (2, 50), (100, 101, 102, 250)])
def test_batches_and_ranks_give_the_distance_of_the_whole(cuts: tuple[int, ...]) -> None:
    x, y = (features + 1000.0 for features in two_sets(3))
    sums = []
    for features in (x, y):
        ranks = [FeatureSums(), FeatureSums()]
        for number, batch in enumerate(np.split(features, cuts)):
            ranks[number % 2] = ranks[number % 2].merged(feature_sums(batch))
        sums.append(ranks[1].merged(ranks[0]))
    np.testing.assert_allclose(sums[0].gaussian.mean, x.mean(axis=0), rtol=1e-13)
    np.testing.assert_allclose(sums[0].gaussian.covariance, np.cov(x, rowvar=False), rtol=1e-9, atol=1e-12)
    assert sums[0].gaussian.num_samples == len(x)
    assert frechet_distance(sums[0].gaussian, sums[1].gaussian) == pytest.approx(fid(x, y), rel=1e-10)


def by_eigenvalues_of_the_product(x: np.ndarray, y: np.ndarray) -> float:
    """The other published way (torch-fidelity): the trace of the root from the product's eigenvalues."""
    a, b = np.cov(x, rowvar=False), np.cov(y, rowvar=False)
    cross = np.sqrt(np.linalg.eigvals(a @ b).astype(complex)).real.sum()
    return float(((x.mean(0) - y.mean(0)) ** 2).sum() + np.trace(a) + np.trace(b) - 2 * cross)


@pytest.mark.parametrize(("num_samples", "num_features"), [(100, 3), (500, 64)])
def test_agrees_with_the_eigenvalues_of_the_product(num_samples: int, num_features: int) -> None:
    x, y = two_sets(11, num_samples, num_features)
    assert fid(x, y) == pytest.approx(by_eigenvalues_of_the_product(x, y), rel=1e-8)


def test_refuses_what_has_no_meaning() -> None:
    x, y = two_sets(5)
    x[17, 3] = np.nan
    with pytest.raises(ValueError, match="the first is row 17"):
        fid(x, y)
    with pytest.raises(ValueError, match="at least 2 samples"):
        fid(y[:1], y)
    with pytest.raises(ValueError, match="12 and 11 features"):
        frechet_distance(fit_gaussian(y), fit_gaussian(y[:, 1:]))
    with pytest.raises(ValueError, match="NaN"):
        Gaussian(np.array([np.nan]), np.eye(1), 5)


def test_fid_infinity_removes_the_bias_of_finite_samples() -> None:
    rng = np.random.default_rng(2)
    x, y = rng.normal(size=(2, 4000, 24))
    extrapolated = fid_infinity(x, y, np.random.default_rng(0))
    assert extrapolated.values[-1] == pytest.approx(fid(x, y), rel=1e-9)
    assert abs(extrapolated.limit) < 0.25 * fid(x, y)
    shifted = fid_infinity(x, y + 0.5, np.random.default_rng(0)).limit
    assert shifted == pytest.approx(0.25 * 24, rel=0.05)


def test_no_line_is_drawn_through_singular_covariances() -> None:
    rng = np.random.default_rng(8)
    x, y = rng.normal(size=(2, 65 * 4, 64))
    assert abs(fid_infinity(x, y, rng).limit) < 1
    with pytest.raises(ValueError, match=r"256 samples of 64 features are too few .* it takes more than 259"):
        fid_infinity(x[:256], y, rng)
