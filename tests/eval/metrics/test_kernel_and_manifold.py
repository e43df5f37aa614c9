"""KID and PRDC against brute force over all pairs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eval.metrics import gaussian, neighbours
from eval.metrics.gaussian import kid
from eval.metrics.neighbours import prdc


def kid_by_pairs(x: np.ndarray, y: np.ndarray) -> float:
    def k(a: np.ndarray, b: np.ndarray) -> float:
        return float((a @ b / len(a) + 1) ** 3)

    n, m = len(x), len(y)
    xx = sum(k(x[i], x[j]) for i in range(n) for j in range(n) if i != j) / (n * (n - 1))
    yy = sum(k(y[i], y[j]) for i in range(m) for j in range(m) if i != j) / (m * (m - 1))
    xy = sum(k(a, b) for a in x for b in y) / (n * m)
    return xx + yy - 2 * xy


def prdc_by_pairs(x: np.ndarray, y: np.ndarray, k: int) -> tuple[float, float, float, float]:
    def radius(points: np.ndarray, i: int) -> float:
        return sorted(float(np.linalg.norm(points[i] - other)) for j, other in enumerate(points) if j != i)[k - 1]

    real_radii = [radius(x, i) for i in range(len(x))]
    fake_radii = [radius(y, i) for i in range(len(y))]
    inside = [[np.linalg.norm(a - b) < r for a, r in zip(x, real_radii, strict=True)] for b in y]
    precision = np.mean([any(row) for row in inside])
    density = np.mean([sum(row) for row in inside]) / k
    recall = np.mean([any(np.linalg.norm(a - b) < r for b, r in zip(y, fake_radii, strict=True)) for a in x])
    coverage = np.mean([min(np.linalg.norm(a - b) for b in y) < r for a, r in zip(x, real_radii, strict=True)])
    return float(precision), float(recall), float(density), float(coverage)


@settings(max_examples=15)
@given(seed=st.integers(0, 2**32), n=st.integers(7, 15), m=st.integers(7, 15), shift=st.floats(0, 2))
def test_agree_with_brute_force(seed: int, n: int, m: int, shift: float) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(n, 3)), rng.normal(size=(m, 3)) + shift
    assert kid(x, y) == pytest.approx(kid_by_pairs(x, y), rel=1e-9, abs=1e-12)
    result = prdc(x, y, 3)
    expected = prdc_by_pairs(x, y, 3)
    assert (result.precision, result.recall, result.density, result.coverage) == pytest.approx(expected, rel=1e-12)


def test_blocks_do_not_change_the_result(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(100, 4)), rng.normal(size=(90, 4)) + 0.5
    whole = kid(x, y), prdc(x, y)
    monkeypatch.setattr(gaussian, "BLOCK_ROWS", 7)
    monkeypatch.setattr(neighbours, "BLOCK_ROWS", 7)
    assert kid(x, y) == pytest.approx(whole[0], rel=1e-12)
    assert prdc(x, y) == whole[1]


def test_known_answers() -> None:
    rng = np.random.default_rng(1)
    x = rng.normal(size=(600, 2))
    far = prdc(x, x + 100.0)
    assert (far.precision, far.recall, far.density, far.coverage) == (0.0, 0.0, 0.0, 0.0)
    same = prdc(x, rng.normal(size=(600, 2)))
    assert min(same.precision, same.recall, same.coverage) > 0.9
    assert same.density == pytest.approx(1.0, abs=0.1)
    assert abs(kid(x, rng.normal(size=(600, 2)))) < 0.02
    assert kid(x, x + 1.0) > 1.0


def test_precision_and_recall_are_not_the_same_side() -> None:
    rng = np.random.default_rng(2)
    real, narrow = rng.normal(size=(500, 2)), 0.2 * rng.normal(size=(500, 2))
    result = prdc(real, narrow)
    assert result.precision > 0.95 > 0.4 > result.recall
    swapped = prdc(narrow, real)
    assert (swapped.precision, swapped.recall) == (result.recall, result.precision)


def test_refusals() -> None:
    x = np.zeros((10, 3))
    bad = x.copy()
    bad[2] = np.inf
    for metric in (kid, prdc):
        with pytest.raises(ValueError, match="the first is row 2"):
            metric(x, bad)
    with pytest.raises(ValueError, match="at least 6 samples"):
        prdc(x[:5], x)


def test_identical_sets_and_constant_features() -> None:
    x = np.random.default_rng(3).normal(size=(200, 4))
    same = prdc(x, x)
    assert (same.precision, same.recall, same.coverage) == (1.0, 1.0, 1.0)
    # The U-statistic of a set with itself leaves out the diagonal on two of three sides: slightly below zero.
    assert -0.2 < kid(x, x) < 0.0
    constant = np.ones((20, 3))
    assert kid(constant, constant) == pytest.approx(0.0, abs=1e-12)
    with pytest.raises(ValueError, match="real: all rows are the same"):
        prdc(constant, x[:20, :3])
    collapsed = prdc(x, np.tile(x[:1], (20, 1)))
    assert (collapsed.precision, collapsed.recall) == (1.0, 0.0)
