"""Retrieval against TMR's rule written out, chance for those who see nothing; similarity of pairs."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eval.metrics.retrieval import RECALL_RANKS, clip_score, cosines, least_similar, retrieval, tmr_score


def plain(distances: np.ndarray, right: np.ndarray) -> tuple[list[float], float]:
    """TMR's metrics where nothing is tied: the place of the nearest right candidate in each sorted row."""
    places = []
    for row, allowed in zip(distances, right, strict=True):
        order = sorted(range(len(row)), key=row.__getitem__)
        places.append(next(place for place, candidate in enumerate(order) if allowed[candidate]))
    return [float(np.mean([place < rank for place in places])) for rank in RECALL_RANKS], float(np.median(places)) + 1


@given(st.integers(1, 40), st.floats(0, 0.3), st.integers(0, 2**32 - 1))
def test_without_ties_it_is_the_place_in_the_sorted_row(number: int, share: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    distances = rng.permutation(number * number).reshape(number, number).astype(np.float64)
    right = (rng.uniform(size=distances.shape) < share) | np.eye(number, dtype=bool)
    found = retrieval(distances, right)
    recall, median = plain(distances, right)
    np.testing.assert_allclose(found.recall, recall, atol=1e-12)
    assert found.median_rank == median and found.num_queries == number


@pytest.mark.parametrize("values", [1, 2, 5])
def test_ties_count_by_their_expectation(values: int) -> None:
    rng = np.random.default_rng(values)
    distances = rng.integers(values, size=(12, 12)).astype(np.float64)
    right = (rng.uniform(size=distances.shape) < 0.2) | np.eye(12, dtype=bool)
    shaken = [retrieval(distances + rng.uniform(0, 0.5, size=distances.shape), right).recall for _ in range(300)]
    np.testing.assert_allclose(retrieval(distances, right).recall, np.mean(shaken, axis=0), atol=0.03)


def test_who_sees_nothing_scores_chance() -> None:
    found = retrieval(np.zeros((50, 50)))
    np.testing.assert_allclose(found.recall, np.array(RECALL_RANKS) / 50)
    assert found.median_rank == 25.5
    # TMR's code gives two motions that are tied in front the place ½, which it counts as a hit of the first rank.
    assert retrieval(np.array([[0.0, 0.0], [1.0, 0.0]])).recall[0] == 0.75


def test_what_cannot_be_ranked_is_refused() -> None:
    with pytest.raises(ValueError, match="finite"):
        retrieval(np.full((2, 2), np.nan))
    with pytest.raises(ValueError, match=r"\(2, 3\): say which"):
        retrieval(np.zeros((2, 3)))
    with pytest.raises(ValueError, match="query 1 has no right"):
        retrieval(np.zeros((2, 2)), np.array([[True, False], [False, False]]))


def test_clip_score_is_the_mean_cosine_of_pairs() -> None:
    x = np.array([[1.0, 0.0], [0.0, 2.0], [3.0, 0.0]])
    y = np.array([[5.0, 0.0], [0.0, -1.0], [0.0, 1.0]])
    assert clip_score(x, y) == pytest.approx(0.0)
    assert clip_score(x, 7 * x) == pytest.approx(1.0) and tmr_score(x, -x) == pytest.approx(0.0)
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 9, 4)).astype(np.float32)
    by_hand = [float(p @ q / np.sqrt((p @ p) * (q @ q))) for p, q in zip(a, b, strict=True)]
    assert clip_score(a, b) == pytest.approx(np.mean(by_hand), rel=1e-5)
    assert tmr_score(a, b) == pytest.approx(np.diag(cosines(a, b)).mean() / 2 + 0.5)
    for wrong, said in ((np.zeros((3, 2)), "length 0"), (np.full((3, 2), np.nan), "NaN")):
        with pytest.raises(ValueError, match=said):
            clip_score(x, wrong)


def test_the_least_similar_rows_are_of_different_kinds() -> None:
    kinds = np.repeat(np.eye(5), 4, axis=0) + 0.01 * np.random.default_rng(0).normal(size=(20, 5))
    chosen = least_similar(cosines(kinds, kinds), 5)
    assert sorted(chosen // 4) == [0, 1, 2, 3, 4]
    assert least_similar(cosines(kinds, kinds), 99).tolist() == list(range(20))
