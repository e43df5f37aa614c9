"""R-Precision and retrieval against their definitions; chance for those who see nothing; similarity of pairs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eval.metrics.retrieval import (
    RECALL_RANKS,
    clip_score,
    cosines,
    least_similar,
    r_precision,
    retrieval,
    tmr_score,
)


def places(distances: np.ndarray, right: np.ndarray) -> list[int]:
    """The place of each query's nearest right candidate in its sorted row, where nothing is tied."""
    found = []
    for row, allowed in zip(distances, right, strict=True):
        order = sorted(range(len(row)), key=row.__getitem__)
        found.append(next(place for place, candidate in enumerate(order) if allowed[candidate]))
    return found


@given(pairs=st.integers(8, 40), pool=st.integers(2, 8), seed=st.integers(0, 1000))
@settings(max_examples=30)
def test_r_precision_agrees_with_its_definition(pairs: int, pool: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    texts = rng.normal(size=(pairs, 4))
    motions = texts + rng.normal(size=(pairs, 4))
    order = np.random.default_rng(seed).permutation(pairs)
    pools = [order[start : start + pool] for start in range(0, pairs - pool + 1, pool)]
    for queries, candidates in ((texts, motions), (motions, texts)):
        top, mm_dist = r_precision(queries, candidates, rng=np.random.default_rng(seed), pool=pool)
        distances = [np.linalg.norm(queries[rows, None] - candidates[rows], axis=-1) for rows in pools]
        ranks = np.concatenate([places(each, np.eye(pool, dtype=bool)) for each in distances])
        np.testing.assert_allclose(top, [(ranks < rank).mean() for rank in (1, 2, 3)])
        assert mm_dist == pytest.approx(np.mean([np.diagonal(each) for each in distances]))


def test_perfect_pairs_are_found_and_chance_is_rank_over_pool() -> None:
    rng = np.random.default_rng(0)
    embeddings = rng.normal(size=(3200, 8)).astype(np.float32)
    perfect, mm_dist = r_precision(embeddings, embeddings, rng=rng)
    assert perfect.tolist() == [1.0, 1.0, 1.0] and mm_dist == 0.0
    chance, _ = r_precision(embeddings, rng.permutation(embeddings), rng=rng)
    np.testing.assert_allclose(chance, np.array([1, 2, 3]) / 32, atol=0.015)
    one_point, _ = r_precision(np.zeros((64, 3)), np.zeros((64, 3)), rng=rng)
    np.testing.assert_allclose(one_point, np.array([1, 2, 3]) / 32)


@given(st.integers(1, 40), st.floats(0, 0.3), st.integers(0, 2**32 - 1))
def test_retrieval_without_ties_is_the_place_in_the_sorted_row(number: int, share: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    distances = rng.permutation(number * number).reshape(number, number).astype(np.float64)
    right = (rng.uniform(size=distances.shape) < share) | np.eye(number, dtype=bool)
    (recall, median_rank), expected = retrieval(distances, right), np.array(places(distances, right))
    np.testing.assert_allclose(recall, [(expected < rank).mean() for rank in RECALL_RANKS], atol=1e-12)
    assert median_rank == np.median(expected) + 1


@pytest.mark.parametrize("values", [1, 2, 5])
def test_ties_count_by_their_expectation(values: int) -> None:
    rng = np.random.default_rng(values)
    distances = rng.integers(values, size=(12, 12)).astype(np.float64)
    right = (rng.uniform(size=distances.shape) < 0.2) | np.eye(12, dtype=bool)
    shaken = [retrieval(distances + rng.uniform(0, 0.5, size=distances.shape), right)[0] for _ in range(300)]
    np.testing.assert_allclose(retrieval(distances, right)[0], np.mean(shaken, axis=0), atol=0.03)


def test_who_sees_nothing_scores_chance() -> None:
    recall, median_rank = retrieval(np.zeros((50, 50)))
    np.testing.assert_allclose(recall, np.array(RECALL_RANKS) / 50)
    assert median_rank == 25.5
    # TMR's code gives two motions that are tied in front the place ½, which it counts as a hit of the first rank.
    assert retrieval(np.array([[0.0, 0.0], [1.0, 0.0]]))[0][0] == 0.75


def test_clip_score_is_the_mean_cosine_of_pairs() -> None:
    a, b = np.random.default_rng(0).normal(size=(2, 9, 4)).astype(np.float32)
    by_hand = [float(p @ q / np.sqrt((p @ p) * (q @ q))) for p, q in zip(a, b, strict=True)]
    assert clip_score(a, b) == pytest.approx(np.mean(by_hand), rel=1e-5)
    assert clip_score(a, 7 * a) == pytest.approx(1.0) and tmr_score(a, -a) == pytest.approx(0.0)
    assert tmr_score(a, b) == pytest.approx(np.diag(cosines(a, b)).mean() / 2 + 0.5)


def test_the_least_similar_rows_are_of_different_kinds() -> None:
    kinds = np.repeat(np.eye(5), 4, axis=0) + 0.01 * np.random.default_rng(0).normal(size=(20, 5))
    chosen = least_similar(cosines(kinds, kinds), 5)
    assert sorted(chosen // 4) == [0, 1, 2, 3, 4]
    assert least_similar(cosines(kinds, kinds), 99).tolist() == list(range(20))


def test_what_cannot_be_ranked_is_refused() -> None:
    rng, zeros, broken = np.random.default_rng(0), np.zeros((32, 2)), np.full((32, 2), np.nan)
    for call, reason in (
        (lambda: r_precision(zeros[:31], zeros[:31], rng=rng), "at least 32 pairs"),
        (lambda: r_precision(broken, broken, rng=rng), "finite"),
        (lambda: retrieval(broken), "finite"),
        (lambda: retrieval(np.zeros((2, 2)), np.array([[True, False], [False, False]])), "query 1 has no right"),
        (lambda: clip_score(np.ones((32, 2)), zeros), "length 0"),
        (lambda: clip_score(np.ones((32, 2)), broken), "NaN"),
    ):
        with pytest.raises(ValueError, match=reason):
            call()
