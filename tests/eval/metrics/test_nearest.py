"""Nearest rows against a search over all pairs, however the set is cut into blocks."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eval.metrics.neighbours import nearest_rows


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32), rows=st.integers(1, 40), size=st.integers(1, 50), offset=st.floats(-3, 3))
def test_agrees_with_a_search_over_all_pairs(seed: int, rows: int, size: int, offset: float) -> None:
    rng = np.random.default_rng(seed)
    queries, candidates = rng.normal(size=(5, 4)) + offset, rng.normal(size=(rows, 4)).astype(np.float32) + offset
    distances = np.linalg.norm(queries[:, None] - candidates[None], axis=-1)
    found = nearest_rows(queries, (candidates[start : start + size] for start in range(0, rows, size)))
    np.testing.assert_allclose(np.linalg.norm(found - queries, axis=1), distances.min(axis=1), rtol=1e-3, atol=1e-4)
    assert {row.tobytes() for row in found} <= {row.tobytes() for row in candidates.astype(np.float32)}


def test_nothing_to_look_among_is_refused() -> None:
    with pytest.raises(ValueError, match="nothing to look"):
        nearest_rows(np.zeros((1, 3)), [np.zeros((0, 3))])
