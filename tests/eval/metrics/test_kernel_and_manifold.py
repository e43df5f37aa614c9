"""KID against torchmetrics, PRDC against its authors' package; known answers and refusals."""

import io
from contextlib import redirect_stdout
from dataclasses import asdict

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from prdc import compute_prdc
from scipy.spatial.distance import cdist
from torchmetrics.image.kid import KernelInceptionDistance

from eval.metrics import gaussian, neighbours
from eval.metrics.distributions import kid, prdc
from tests.helpers.given_features import GivenFeatures


def kid_of_torchmetrics(x: np.ndarray, y: np.ndarray) -> float:
    """One subset of all samples; torchmetrics' subsets have one size on both sides."""
    with pytest.warns(UserWarning, match="large memory footprint"):
        metric = KernelInceptionDistance(feature=GivenFeatures(x.shape[1]), subsets=1, subset_size=len(x))
    metric.set_dtype(torch.float64)
    metric.update(torch.from_numpy(x), real=True)
    metric.update(torch.from_numpy(y), real=False)
    return float(metric.compute()[0])


@settings(max_examples=15)
@given(seed=st.integers(0, 2**32), n=st.integers(7, 40), m=st.integers(7, 40), shift=st.floats(0, 2))
def test_prdc_agrees_with_its_authors(seed: int, n: int, m: int, shift: float) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(n, 3)), rng.normal(size=(m, 3)) + shift
    with redirect_stdout(io.StringIO()):
        expected = compute_prdc(x, y, nearest_k=3)
    assert asdict(prdc(x, y, 3)) == pytest.approx(expected, rel=1e-12)


def by_differences(x: np.ndarray, y: np.ndarray, k: int) -> dict[str, float]:
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


@settings(max_examples=15)
@given(seed=st.integers(0, 2**32), away=st.sampled_from([0.0, 1e4, 1e7]), scale=st.sampled_from([1e-3, 1.0]))
def test_prdc_far_from_the_origin(seed: int, away: float, scale: float) -> None:
    """|a|² + |b|² − 2ab about the origin has no digit left of distances of 1e-3 at 1e7."""
    rng = np.random.default_rng(seed)
    x, y = (away + scale * (rng.normal(size=(60, 5)) + shift) for shift in (0.0, 0.5))
    assert asdict(prdc(x, y, 3)) == pytest.approx(by_differences(x, y, 3), rel=1e-12)
    if away <= 1e4 and scale == 1.0:
        with redirect_stdout(io.StringIO()):
            assert asdict(prdc(x, y, 3)) == pytest.approx(compute_prdc(x, y, nearest_k=3), rel=1e-12)


@settings(max_examples=15)
@given(seed=st.integers(0, 2**32), away=st.sampled_from([0.0, 1e3]))
def test_ties_fall_outside_whatever_the_rounding(seed: int, away: float) -> None:
    """Points of a lattice have many equal distances, which a difference of squares tells apart by its rounding."""
    rng = np.random.default_rng(seed)
    x, y = (rng.integers(0, 4, size=(50, 3)) + away for _ in range(2))
    assert asdict(prdc(x / 4, y / 4, 3)) == pytest.approx(by_differences(x / 4, y / 4, 3), rel=1e-12)


@settings(max_examples=15)
@given(seed=st.integers(0, 2**32), n=st.integers(7, 40), shift=st.floats(0, 2))
def test_kid_agrees_with_torchmetrics(seed: int, n: int, shift: float) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(n, 3)), rng.normal(size=(n, 3)) + shift
    assert kid(x, y) == pytest.approx(kid_of_torchmetrics(x, y), rel=1e-9, abs=1e-12)


def test_blocks_do_not_change_the_result(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(100, 4)), rng.normal(size=(90, 4)) + 0.5
    whole = kid(x, y), prdc(x, y)
    monkeypatch.setattr(gaussian, "BLOCK_ROWS", 7)
    monkeypatch.setattr(neighbours, "BLOCK_ROWS", 7)
    assert kid(x, y) == pytest.approx(whole[0], rel=1e-12)
    assert prdc(x, y) == whole[1]


def test_refusals() -> None:
    x = np.random.default_rng(0).normal(size=(10, 3))
    bad = x.copy()
    bad[2] = np.inf
    for metric in (kid, prdc):
        with pytest.raises(ValueError, match="the first is row 2"):
            metric(x, bad)
    with pytest.raises(ValueError, match="at least 6 samples"):
        prdc(x[:5], x)


@pytest.mark.parametrize(("offset", "refused"), [(1e2, False), (1e3, True), (1e6, True)])
def test_kid_refuses_features_whose_differences_are_rounding_errors(offset: float, refused: bool) -> None:
    x, y = np.random.default_rng(5).normal(size=(2, 50, 3)).astype(np.float32) + np.float32(offset)
    if refused:
        with pytest.raises(ValueError, match="subtract the real set's mean"):
            kid(x, y)
    else:
        assert np.isfinite(kid(x, y))
