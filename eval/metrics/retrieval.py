"""Retrieval: R-Precision in pools, ranks among all candidates of which several may be relevant, similarity of pairs.

R-Precision (text-to-motion, final_evaluations.py) ranks for each text the motions of its pool; the NeRM paper describes
the reverse, for each motion its texts. Both come from one matrix of distances per pool; a table says which it used.
"""

import numpy as np
from scipy.spatial.distance import cdist

from eval.metrics.distributions import checked_features
from eval.metrics.metric import Metric, by_frames
from motionkit.core.shapes import Bool, Float, Float64, Int64

RECALL_RANKS = (1, 2, 3, 5, 10)
REFERENCE_POOL = 32
RANKS = 3
Embeddings = Float[np.ndarray, "pairs numbers"]


def retrieval(
    distances: Float[np.ndarray, "queries candidates"], right: Bool[np.ndarray, "queries candidates"] | None = None
) -> tuple[Float64[np.ndarray, "ranks"], float]:
    """Recall at each k of `RECALL_RANKS`, and the median rank, from 1, of the nearest relevant candidate.

    Recall at k is the share of queries with a relevant candidate among the k nearest. `right` says which candidates are
    relevant to a query; by default candidate i to query i alone. Candidates at one distance share their ranks: a hit
    counts by its expectation over their random order, so an evaluator that maps everything to one point scores chance.
    Raises `ValueError` for distances that are not finite, and for a query without a relevant candidate. Source: TMR.
    """
    if not np.isfinite(distances).all() or not distances.size:
        raise ValueError("retrieval needs finite distances, of one query at least")
    right = np.eye(*distances.shape, dtype=np.bool_) if right is None else right
    if not right.any(axis=1).all():
        raise ValueError(f"query {int(np.argmin(right.any(axis=1)))} has no right candidate")
    own = np.where(right, distances, np.inf).min(axis=1, keepdims=True)
    nearer, tied = (distances < own).sum(axis=1), distances == own
    equals, relevant = tied.sum(axis=1), (tied & right).sum(axis=1)
    # The probability that none of the relevant ones is among the first `free` of the tied ones, without replacement.
    recall = []
    for rank in RECALL_RANKS:
        missed = np.ones(len(distances))
        for drawn in range(rank):
            left = np.maximum(equals - drawn, 1)
            miss = np.where(drawn < rank - nearer, np.clip((equals - relevant - drawn) / left, 0.0, 1.0), 1.0)
            missed *= miss
        recall.append(float((1.0 - missed).mean()))
    ranks = nearer + (equals + 1) / (relevant + 1)
    return np.array(recall), float(np.median(ranks))


def clip_score(queries: Embeddings, candidates: Embeddings) -> float:
    """Mean cosine of the angle between the embeddings of each pair, text and motion: −1 to 1.

    CLIP-score as MARDM computes it, on the embeddings of its MotionCLIP: not scaled by 2.5 and not cut at 0 as the
    CLIPScore of images is (Hessel et al. 2021). Raises `ValueError` for unequal shapes, no pairs, rows that are zero or
    not finite. Source: neu-vi/MARDM @ 443313b, utils/eval_utils.py, evaluation_mardm.
    """
    return float(np.einsum("ij,ij->i", _directions(queries, "queries"), _directions(candidates, "candidates")).mean())


def _directions(rows: Float[np.ndarray, "rows numbers"], name: str) -> Float64[np.ndarray, "rows numbers"]:
    values = checked_features(rows, name, minimum=1)
    lengths = np.linalg.norm(values, axis=1, keepdims=True)
    if not (lengths > 0).all():
        raise ValueError(f"{name}: a row of length 0 has no direction")
    return np.asarray(values / lengths)


def tmr_score(queries: Embeddings, candidates: Embeddings) -> float:
    """½ + ½ · `clip_score`: the score of pairs in TMR's code and in Kimodo's (kimodo/metrics/tmr.py), 0 to 1."""
    return 0.5 + 0.5 * clip_score(queries, candidates)


def cosines(
    a: Float[np.ndarray, "rows numbers"], b: Float[np.ndarray, "others numbers"]
) -> Float64[np.ndarray, "rows others"]:
    """Cosines of the angles between all rows. Raises `ValueError` for a row of zeros, NaN or infinity."""
    return np.asarray(_directions(a, "a") @ _directions(b, "b").T)


def least_similar(similarity: Float[np.ndarray, "rows rows"], number: int) -> Int64[np.ndarray, "chosen"]:
    """Rows of least mutual similarity by a greedy choice, in ascending order.

    First the row of the least mean similarity, then always the one whose maximum similarity to those chosen is least.
    """
    chosen = [int(similarity.mean(axis=1).argmin())]
    nearest = similarity[chosen[0]].astype(np.float64)
    nearest[chosen[0]] = np.inf
    while len(chosen) < min(number, len(similarity)):
        chosen.append(int(nearest.argmin()))
        nearest = np.maximum(nearest, similarity[chosen[-1]])
        nearest[chosen] = np.inf
    return np.sort(np.array(chosen, dtype=np.int64))


def r_precision(
    queries: Embeddings, candidates: Embeddings, *, rng: np.random.Generator, pool: int = REFERENCE_POOL
) -> tuple[Float64[np.ndarray, "ranks"], float]:
    """R-Precision for each number of nearest candidates from 1, and MM-Dist, the pairs' mean distance.

    Pairs are shuffled and cut into pools, in which each query's own candidate is ranked by Euclidean distance. Row i of
    `queries` belongs to row i of `candidates`. The last, incomplete pool is dropped, as in the reference. Candidates at
    one distance share their ranks, as in `retrieval`. Distances are exact, in float64 (the usual √(a² + b² − 2ab) in
    float32 gives NaN for equal vectors). Raises `ValueError` for fewer pairs than a pool or rows that are not finite.
    """
    distances = pool_distances(queries, candidates, rng.permutation(len(queries)), pool)
    top = hits(distances).reshape(RANKS, -1).mean(axis=1)
    return top, float(np.diagonal(distances, axis1=1, axis2=2).mean())


def pool_distances(
    queries: Embeddings, candidates: Embeddings, order: Int64[np.ndarray, "chosen"], pool: int = REFERENCE_POOL
) -> Float64[np.ndarray, "pools pool pool"]:
    """Euclidean distances inside pools that are cut from the pairs in `order`; [i, j, j] is a pair's own distance.

    Raises `ValueError` for fewer pairs than a pool or rows that are not finite.
    """
    if len(order) < pool:
        raise ValueError(f"R-Precision in pools of {pool} needs at least {pool} pairs, there are {len(order)}")
    if not (np.isfinite(queries).all() and np.isfinite(candidates).all()):
        raise ValueError("R-Precision needs finite embeddings")
    pools = order[: len(order) // pool * pool].reshape(-1, pool)
    return np.stack([cdist(queries[members], candidates[members]) for members in pools])


def hits(distances: Float64[np.ndarray, "pools pool pool"]) -> Float64[np.ndarray, "ranks pools pool"]:
    """Whether each query's (row's) own candidate is among the 1, 2, … nearest; ties share the hit."""
    own = np.diagonal(distances, axis1=1, axis2=2)
    nearer = (distances < own[..., None]).sum(axis=-1)
    tied = (distances == own[..., None]).sum(axis=-1)
    return np.stack([np.clip((rank - nearer) / tied, 0.0, 1.0) for rank in range(1, RANKS + 1)])


_T2M, _TMR = "text-to-motion (Guo et al. 2022)", "TMR (Petrovich et al. 2023)"
_TEXT, _MOTION, _REAL = ("", ""), ("_motion_asks", " (a motion asks)"), ("_real_asked", " (for the real one)")
METRICS = (
    Metric("clip_score", "CLIP-score", "", True, "MARDM (Meng et al. 2024)", clip_score, by_frames),
    Metric("tmr_score", "TMR score", "", True, "TMR; Kimodo (Rempe et al. 2026)", tmr_score, by_frames),
    Metric("mm_dist", "MultiModal Dist", "", False, _T2M, r_precision),
    *(
        Metric(f"r_precision_top{rank}{suffix}", f"R-Precision, top {rank}{title}", "", True, source, r_precision)
        for (suffix, title), source in (
            (_TEXT, f"{_T2M}: a text asks for its motion"),
            (_MOTION, "NeRM, appendix: a motion asks for its text"),
        )
        for rank in range(1, RANKS + 1)
    ),
    *(
        Metric(f"recall_at_{rank}{suffix}", f"R@{rank}{title}", "", True, source, retrieval)
        for (suffix, title), source in (
            (_TEXT, f"{_TMR}: a text asks for its motion"),
            (_MOTION, f"{_TMR}: a motion asks for its text"),
            (_REAL, "Kimodo: a motion asks for the real motion of its text"),
        )
        for rank in RECALL_RANKS
    ),
    *(
        Metric(f"median_rank{suffix}", f"MedR{title}", "", False, _TMR, retrieval)
        for suffix, title in (_TEXT, _MOTION, _REAL)
    ),
)
