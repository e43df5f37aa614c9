"""FID, KID and PRDC against independent implementations; known answers, properties, refusals."""

import io
from contextlib import redirect_stdout

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from mpmath import matrix, mp
from prdc import compute_prdc
from scipy.spatial.distance import cdist
from torchmetrics.image.fid import FrechetInceptionDistance
from torchmetrics.image.kid import KernelInceptionDistance

from eval.metrics import distributions
from eval.metrics.distributions import fid, fid_infinity, fit_gaussian, frechet_distances, kid, prdc
from tests.helpers.given_features import GivenFeatures


def two_sets(seed: int, num_samples: int = 300, num_features: int = 12) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    mixing = rng.normal(size=(2, num_features, num_features))
    x, y = rng.normal(size=(2, num_samples, num_features))
    return x @ mixing[0], y @ mixing[1] + 0.3


def fid_of_torchmetrics(x: np.ndarray, y: np.ndarray) -> float:
    metric = FrechetInceptionDistance(feature=GivenFeatures(x.shape[1]))
    metric.set_dtype(torch.float64)
    metric.update(torch.from_numpy(x), real=True)
    metric.update(torch.from_numpy(y), real=False)
    return float(metric.compute())


def fid_in_fifty_digits(x: np.ndarray, y: np.ndarray) -> float:
    with mp.workdps(50):
        parts = []
        for samples in (x, y):
            rows = matrix(samples.tolist())
            mean = matrix([sum(rows[i, j] for i in range(rows.rows)) / rows.rows for j in range(rows.cols)]).T
            centred = matrix([[rows[i, j] - mean[j] for j in range(rows.cols)] for i in range(rows.rows)])
            parts.append((mean, centred.T * centred / (rows.rows - 1)))
        (mean_a, a), (mean_b, b) = parts
        cross = sum(mp.sqrt(mp.re(value)) for value in mp.eig(a * b, left=False, right=False))
        shift = mean_a - mean_b
        trace = sum(a[i, i] + b[i, i] for i in range(a.rows))
        return float(sum(value**2 for value in shift) + trace - 2 * cross)


@pytest.mark.parametrize(
    ("reference", "num_samples", "num_features", "rel"),
    [
        (fid_of_torchmetrics, 300, 12, 1e-9),
        (fid_in_fifty_digits, 20, 4, 1e-13),
    ],
)
def test_fid_agrees_with_independent_implementations(reference, num_samples, num_features, rel) -> None:  # type: ignore[no-untyped-def]
    x, y = two_sets(7, num_samples, num_features)
    assert fid(x, y) == pytest.approx(reference(x, y), rel=rel)
    first, second = fit_gaussian(x), fit_gaussian(y)
    quick = frechet_distances(first.mean[None], first.factor[None], second.mean[None], second.covariance[None])
    assert quick == pytest.approx([fid(x, y)], rel=1e-6)


def test_fewer_samples_than_features_is_a_distance_of_degenerate_gaussians() -> None:
    x, y = np.random.default_rng(0).normal(size=(2, 6, 40))
    # The same distance inside the span of both sets, where nothing is degenerate beyond what the samples are.
    basis = np.linalg.svd(np.concatenate((x, y)), full_matrices=False)[2]
    assert fid(x, y) == pytest.approx(fid(x @ basis.T, y @ basis.T), rel=1e-10)
    assert fid(x, x) == pytest.approx(0.0, abs=1e-10)


def test_fid_infinity_removes_the_bias_of_finite_samples() -> None:
    rng = np.random.default_rng(2)
    x, y = rng.normal(size=(2, 4000, 24))
    assert abs(fid_infinity(x, y, np.random.default_rng(0))) < 0.25 * fid(x, y)
    assert fid_infinity(x, y + 0.5, np.random.default_rng(0)) == pytest.approx(0.25 * 24, rel=0.05)
    x, y = rng.normal(size=(2, 65 * 4, 64))
    assert abs(fid_infinity(x, y, rng)) < 1
    with pytest.raises(ValueError, match=r"256 samples are too few .* 64 features need 260"):
        fid_infinity(x[:256], y, rng)


@settings(max_examples=15)
@given(seed=st.integers(0, 2**32), n=st.integers(7, 40), shift=st.floats(0, 2))
def test_kid_agrees_with_torchmetrics(seed: int, n: int, shift: float) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(n, 3)), rng.normal(size=(n, 3)) + shift
    with pytest.warns(UserWarning, match="large memory footprint"):
        metric = KernelInceptionDistance(feature=GivenFeatures(3), subsets=1, subset_size=n)
    metric.set_dtype(torch.float64)
    metric.update(torch.from_numpy(x), real=True)
    metric.update(torch.from_numpy(y), real=False)
    assert kid(x, y) == pytest.approx(float(metric.compute()[0]), rel=1e-9, abs=1e-12)


def prdc_by_differences(x: np.ndarray, y: np.ndarray, k: int) -> dict[str, float]:
    """The definition with distances from differences."""
    real_radii, generated_radii = (np.sort(cdist(each, each), axis=1)[:, k] for each in (x, y))
    distances = cdist(x, y)
    in_real_balls = distances < real_radii[:, None]
    return {
        "precision": in_real_balls.any(axis=0).mean(),
        "recall": (distances < generated_radii).any(axis=1).mean(),
        "density": in_real_balls.sum(axis=0).mean() / k,
        "coverage": in_real_balls.any(axis=1).mean(),
    }


@settings(max_examples=20)
@given(
    seed=st.integers(0, 2**32),
    n=st.integers(7, 60),
    away=st.sampled_from([0.0, 1e4, 1e7]),
    scale=st.sampled_from([1e-3, 1.0]),
    lattice=st.booleans(),
)
def test_prdc_agrees_with_its_definition_and_its_authors_even_far_from_the_origin_and_for_ties(
    seed: int, n: int, away: float, scale: float, lattice: bool
) -> None:
    rng = np.random.default_rng(seed)
    if lattice:  # many equal distances, which a difference of squares tells apart by its rounding
        away, scale = min(away, 1e4), 1.0
        x, y = (rng.integers(0, 4, size=(size, 3)) / 4 + away for size in (50, 40))
    else:
        x, y = (away + scale * (rng.normal(size=(size, 5)) + shift) for size, shift in ((n, 0.0), (40, 0.5)))
    assert prdc(x, y, 3) == pytest.approx(prdc_by_differences(x, y, 3), rel=1e-12)
    if away <= 1e4 and scale == 1.0 and not lattice:
        with redirect_stdout(io.StringIO()):
            assert prdc(x, y, 3) == pytest.approx(compute_prdc(x, y, nearest_k=3), rel=1e-12)


def test_blocks_do_not_change_the_result(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(100, 4)), rng.normal(size=(90, 4)) + 0.5
    whole = kid(x, y), prdc(x, y)
    monkeypatch.setattr(distributions, "BLOCK_ROWS", 7)
    assert kid(x, y) == pytest.approx(whole[0], rel=1e-12)
    assert prdc(x, y) == whole[1]


def test_refusals() -> None:
    x, y = two_sets(5)
    broken = x.copy()
    broken[17, 3] = np.nan
    for metric in (fid, kid, prdc):
        with pytest.raises(ValueError, match="row 17 holds NaN"):
            metric(broken, y)
        with pytest.raises(ValueError, match="at least"):
            metric(y[:1], y)
    with pytest.raises(ValueError, match="all rows are the same"):
        prdc(np.ones((9, 12)), y)
