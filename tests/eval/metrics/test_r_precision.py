import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eval.metrics.retrieval import r_precision


def naive(queries: np.ndarray, candidates: np.ndarray, order: np.ndarray, pool: int, rank: int) -> float:
    """Straight from the definition: one query after another."""
    hits, total = 0, 0
    for start in range(0, len(order) - pool + 1, pool):
        members = order[start : start + pool]
        for query in members:
            by_distance = sorted(members, key=lambda other: float(np.linalg.norm(queries[query] - candidates[other])))
            hits += query in by_distance[:rank]
            total += 1
    return hits / total


@given(pairs=st.integers(8, 40), pool=st.integers(2, 8), seed=st.integers(0, 1000))
@settings(max_examples=30)
def test_agrees_with_the_definition(pairs: int, pool: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    queries = rng.normal(size=(pairs, 4))
    candidates = queries + rng.normal(size=(pairs, 4))
    found = r_precision(queries, candidates, rng=np.random.default_rng(seed), pool=pool)
    order = np.random.default_rng(seed).permutation(pairs)
    for rank in (1, 2, 3):
        assert found.top[rank - 1] == pytest.approx(naive(queries, candidates, order, pool, rank))
    assert found.num_queries == pairs // pool * pool


def test_perfect_pairs_are_found_and_chance_is_rank_over_pool() -> None:
    rng = np.random.default_rng(0)
    embeddings = rng.normal(size=(3200, 8)).astype(np.float32)
    assert r_precision(embeddings, embeddings, rng=rng).top.tolist() == [1.0, 1.0, 1.0]
    assert r_precision(embeddings, embeddings, rng=rng).matching_distance == 0.0
    chance = r_precision(embeddings, rng.permutation(embeddings), rng=rng).top
    assert np.allclose(chance, np.array([1, 2, 3]) / 32, atol=0.015)


def test_one_point_for_everything_scores_chance() -> None:
    found = r_precision(np.zeros((64, 3)), np.zeros((64, 3)), rng=np.random.default_rng(0))
    assert np.allclose(found.top, np.array([1, 2, 3]) / 32)


@pytest.mark.parametrize(
    ("queries", "message"), [(np.zeros((31, 2)), "at least 32 pairs"), (np.full((32, 2), np.nan), "finite")]
)
def test_bad_input_is_refused(queries: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        r_precision(queries, queries, rng=np.random.default_rng(0))
