"""Intervals: over replications, and over resampled takes: their weights, means, Gaussians, and when rows differ."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eval.metrics.distributions import fit_gaussian
from eval.metrics.intervals import (
    Number,
    UnitSums,
    blocks_for,
    half_width,
    over_replications,
    resampling_weights,
    units_of,
    weighted_means,
    with_takes,
)


def test_interval_over_replications_is_the_reference_protocols() -> None:
    values = [1.0, 2.0, 4.0, 5.0]
    result = over_replications(values)
    assert result.value == 3.0
    assert result.ci95 == pytest.approx(1.96 * np.std(values) / 2)
    assert over_replications([3.0]).ci95 == 0.0


def takes_of(values: list[int]) -> list[str]:
    return [f"take{value}" for value in values]


def test_a_take_is_drawn_as_often_wherever_it_is_and_once_on_average() -> None:
    first, second = resampling_weights(["a", "b"], 4000), resampling_weights(["c", "b", "a"], 4000)
    np.testing.assert_array_equal(first, second[:, [2, 1]])
    assert not np.array_equal(first[:, 0], first[:, 1])
    np.testing.assert_allclose([first.mean(), first.var()], 1.0, atol=0.06)
    assert not np.array_equal(first, resampling_weights(["a", "b"], 4000, seed=1))


def test_generations_are_drawn_whole_beside_takes() -> None:
    units = units_of(["a", "a", "b", "b", "a"], [0, 1, 0, 1, 0])
    np.testing.assert_array_equal(units.unit, [0, 1, 2, 3, 0])
    weights = units.weights()
    ratio = weights[:, 0] * weights[:, 3] - weights[:, 1] * weights[:, 2]
    np.testing.assert_array_equal(ratio, 0.0)  # a product of what its take and its generation count
    one = units_of(["a", "b"], [0, 0])
    np.testing.assert_array_equal(one.weights(), units_of(["a", "b"]).weights())


def test_many_takes_are_drawn_in_blocks_that_depend_on_their_names_alone() -> None:
    assert blocks_for(300, 60) is None
    assert blocks_for(4384, 512) == 128
    names = takes_of(list(range(500)))
    whole, some = units_of(names, blocks=64), units_of(names[100:200], blocks=64)
    assert len(whole.takes) == 64
    assert [whole.takes[unit] for unit in whole.unit[100:200]] == [some.takes[unit] for unit in some.unit]


@given(counts=st.lists(st.integers(0, 3), min_size=4, max_size=4).filter(any), seed=st.integers(0, 99))
def test_a_weighted_gaussian_is_the_gaussian_of_repeated_takes(counts: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    features, unit = rng.normal(100.0, 1.0, (40, 3)), np.repeat(np.arange(4), 10)
    sums = UnitSums(units_of(takes_of([0, 1, 2, 3])), features.mean(axis=0))
    sums.add(features[:25], unit[:25])
    sums.add(features[25:], unit[25:])
    number, mean, covariance = (each[0] for each in sums.gaussians(np.array([counts], dtype=np.float64)))
    expected = fit_gaussian(np.repeat(features, np.array(counts)[unit], axis=0))
    assert number == 10 * sum(counts)
    np.testing.assert_allclose(mean, expected.mean, rtol=1e-12)
    np.testing.assert_allclose(covariance, expected.covariance, atol=1e-12)


def test_the_interval_of_a_mean_is_that_of_its_takes_and_not_of_its_values() -> None:
    rng = np.random.default_rng(1)
    takes = rng.normal(size=200)
    values, unit = np.repeat(takes, 30) + 0.01 * rng.normal(size=6000), np.repeat(np.arange(200), 30)
    weights = units_of(takes_of(list(range(200)))).weights(1000)
    width = half_width(weighted_means(values, unit, weights))
    assert width == pytest.approx(1.96 * takes.std() / np.sqrt(200), rel=0.1)
    assert half_width((None, 1.0)) is None


def test_paired_rows_are_distinguished_where_unpaired_ones_are_not() -> None:
    rng = np.random.default_rng(2)
    hard = 10.0 * rng.normal(size=50)
    rows = [hard + shift + 0.1 * rng.normal(size=50) for shift in (0.0, -0.5)]
    weights = units_of(takes_of(list(range(50)))).weights()
    resampled = [weighted_means(row, np.arange(50), weights) for row in rows]
    means = [float(row.mean()) for row in rows]
    difference = with_takes(means[1], resampled[1]).less(with_takes(means[0], resampled[0]))
    assert difference is not None
    assert difference.verdict == "lower"
    widths = [half_width(values) for values in resampled]
    assert min(width for width in widths if width) > 4 * abs(difference.value)
    assert Number(1.0).less(with_takes(2.0, resampled[0])) is None
    assert [Number(value, 0.5).verdict for value in (0.5, 0.6, -0.6)] == ["not told apart", "higher", "lower"]
