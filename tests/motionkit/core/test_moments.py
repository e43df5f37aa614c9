"""Moments of parts are those of the whole."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from motionkit.core.moments import moments, stream


@given(st.integers(0, 2**32 - 1), st.lists(st.integers(1, 40), min_size=1, max_size=6))
def test_a_stream_of_parts_is_the_whole(seed: int, sizes: list[int]) -> None:
    rows = np.random.default_rng(seed).normal(loc=1e4, size=(sum(sizes), 3)).astype(np.float32)
    found = stream(np.split(rows, np.cumsum(sizes)[:-1]))
    assert found.count == len(rows)
    assert np.allclose(found.mean, rows.astype(np.float64).mean(0), rtol=1e-12)
    assert np.allclose(found.std, rows.astype(np.float64).std(0), rtol=1e-7, atol=1e-9)


def test_unusable_rows_are_refused() -> None:
    for rows in (np.zeros((0, 3)), np.array([[1.0, np.nan]])):
        with pytest.raises(ValueError):
            moments(rows)
    with pytest.raises(ValueError):
        stream([])
