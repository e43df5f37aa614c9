"""Retrieval by a protocol's rules: the candidates, texts that count as the same, and both directions."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.spatial.distance import cdist

from eval.metrics.number import Number, over_replications
from eval.metrics.retrieval import RECALL_RANKS, cosines, least_similar, retrieval
from eval.text_motion.pairs import TextMotionPairs
from eval.text_motion.protocol import RetrievalRule
from motionkit.core.shapes import Bool, Float

RETRIEVAL = 9
"""The random stream of pools."""
SUFFIXES: Mapping[str, str] = {
    "text asks for motion": "",
    "motion asks for text": "_motion_asks",
    "motion asks for real motion": "_real_asked",
}


def score_retrieval(
    real: TextMotionPairs,
    draws: Sequence[TextMotionPairs],
    rule: RetrievalRule,
    sentences: Float[np.ndarray, "pairs numbers"],
    seed: int,
    distance: Callable[..., Float[np.ndarray, "queries candidates"]] = cdist,
) -> dict[str, Number]:
    """Recalls and median ranks by their names in `eval.metrics.metric`, means over the draws (and over pools).

    Row i of every draw was generated for text i, whose real motion is row i of `real` and whose sentence embedding, of
    an independent encoder, is row i of `sentences`. Candidates are ranked by `distance`, Euclidean by default: of
    embeddings of length 1 that is the order of cosines. Raises `ValueError` for fewer pairs than a pool.
    """
    found: dict[str, list[float]] = {}
    for draw in draws:
        right = _right(rule, draw, sentences)
        for rows in _groups(rule, sentences, seed):
            sides = {
                "text asks for motion": (draw.texts, draw.motions),
                "motion asks for text": (draw.motions, draw.texts),
                "motion asks for real motion": (draw.motions, real.motions),
            }
            for direction in rule.directions:
                queries, candidates = (side[rows] for side in sides[direction])
                ranked = retrieval(distance(queries, candidates), None if right is None else right[np.ix_(rows, rows)])
                suffix = SUFFIXES[direction]
                for rank, share in zip(RECALL_RANKS, ranked.recall.tolist(), strict=True):
                    found.setdefault(f"recall_at_{rank}{suffix}", []).append(share)
                found.setdefault(f"median_rank{suffix}", []).append(ranked.median_rank)
    return {name: over_replications(values) for name, values in found.items()}


def no_distance(
    queries: Float[np.ndarray, "queries numbers"], candidates: Float[np.ndarray, "candidates numbers"]
) -> Float[np.ndarray, "queries candidates"]:
    """Constant distances, by which retrieval is chance."""
    return np.zeros((len(queries), len(candidates)))


def share_of_same_texts(
    rule: RetrievalRule, pairs: TextMotionPairs, sentences: Float[np.ndarray, "pairs numbers"]
) -> float:
    """Mean fraction of the other texts that count as the same by the rule, which chance gains from."""
    right = _right(rule, pairs, sentences)
    number = len(pairs.texts)
    return 0.0 if right is None or number < 2 else float((right.sum() - number) / (number * (number - 1)))


def _right(
    rule: RetrievalRule, draw: TextMotionPairs, sentences: Float[np.ndarray, "pairs numbers"]
) -> Bool[np.ndarray, "pairs pairs"] | None:
    """Relevant candidates of every query: those with the same text by the rule."""
    if rule.same_above is None:
        return None
    texts = sentences if rule.same_by == "sentences" else draw.texts
    right = cosines(texts, texts) > 2.0 * rule.same_above - 1.0
    np.fill_diagonal(right, True)
    return right


def _groups(rule: RetrievalRule, sentences: Float[np.ndarray, "pairs numbers"], seed: int) -> list[np.ndarray]:
    """The rows that are ranked together."""
    number = len(sentences)
    if rule.pool is not None:
        if number < rule.pool:
            raise ValueError(f"{rule.name}: {number} pairs do not fill a pool of {rule.pool}")
        order = np.random.default_rng((seed, RETRIEVAL)).permutation(number)
        return list(order[: number // rule.pool * rule.pool].reshape(-1, rule.pool))
    if rule.least_similar is not None:
        return [least_similar(cosines(sentences, sentences), rule.least_similar)]
    return [np.arange(number)]
