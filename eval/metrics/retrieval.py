"""Retrieval among all candidates, of which several may be relevant; similarity of pairs.

R-Precision (`r_precision`) is retrieval in pools of 32 at the first three ranks.
"""

from dataclasses import dataclass

import numpy as np

from eval.metrics.checks import checked_features
from eval.metrics.metric import Metric, by_frames
from motionkit.core.shapes import Bool, Float, Float64, Int64

RECALL_RANKS = (1, 2, 3, 5, 10)


@dataclass(frozen=True, eq=False)
class Retrieval:
    """`recall`: fraction of queries with a relevant candidate among the k nearest, for each k of `RECALL_RANKS`.

    `median_rank` is the median over the queries of the rank of their nearest relevant candidate, from 1.
    """

    recall: Float64[np.ndarray, "ranks"]
    median_rank: float
    num_queries: int


def retrieval(
    distances: Float[np.ndarray, "queries candidates"], right: Bool[np.ndarray, "queries candidates"] | None = None
) -> Retrieval:
    """Rank every query's candidates by distance and find the first relevant one.

    `right` says which candidates are relevant to a query; by default candidate i to query i alone. Candidates at one
    distance share their ranks: a hit counts by its expectation over their random order, so an evaluator that maps
    everything to one point scores chance. Raises `ValueError` for distances that are not finite, or not square without
    `right`, and for a query without a relevant candidate. Source: TMR (Petrovich et al. 2023).
    """
    if not np.isfinite(distances).all() or not distances.size:
        raise ValueError("retrieval needs finite distances, of one query at least")
    if right is None:
        if distances.shape[0] != distances.shape[1]:
            raise ValueError(f"distances are {distances.shape}: say which candidates are right")
        right = np.eye(len(distances), dtype=np.bool_)
    if not right.any(axis=1).all():
        raise ValueError(f"query {int(np.argmin(right.any(axis=1)))} has no right candidate")
    own = np.where(right, distances, np.inf).min(axis=1, keepdims=True)
    nearer, tied = (distances < own).sum(axis=1), distances == own
    equals, answers = tied.sum(axis=1), (tied & right).sum(axis=1)
    # The probability that none of the relevant ones is among the first `free` of the tied ones, without replacement.
    recall = []
    for rank in RECALL_RANKS:
        missed = np.ones(len(distances))
        for drawn in range(rank):
            left = np.maximum(equals - drawn, 1)
            miss = np.where(drawn < rank - nearer, np.clip((equals - answers - drawn) / left, 0.0, 1.0), 1.0)
            missed *= miss
        recall.append(float((1.0 - missed).mean()))
    ranks = nearer + (equals + 1) / (answers + 1)
    return Retrieval(np.array(recall), float(np.median(ranks)), len(distances))


RECALLS = tuple(
    Metric(
        f"recall_at_{rank}{suffix}",
        f"R@{rank}{title}",
        "",
        True,
        source,
        "one set",
        retrieval,
    )
    for suffix, title, source in (
        ("", "", "TMR (Petrovich et al. 2023): a text asks for its motion"),
        ("_motion_asks", " (a motion asks)", "TMR (Petrovich et al. 2023): a motion asks for its text"),
        ("_real_asked", " (for the real one)", "Kimodo: a motion asks for the real motion of its text"),
    )
    for rank in RECALL_RANKS
)
MEDIAN_RANKS = tuple(
    Metric(f"median_rank{suffix}", f"MedR{title}", "", False, "TMR (Petrovich et al. 2023)", "one set", retrieval)
    for suffix, title in (("", ""), ("_motion_asks", " (a motion asks)"), ("_real_asked", " (for the real one)"))
)


def clip_score(queries: Float[np.ndarray, "pairs numbers"], candidates: Float[np.ndarray, "pairs numbers"]) -> float:
    """Mean cosine of the angle between the embeddings of each pair, text and motion: −1 to 1.

    CLIP-score as MARDM computes it, on the embeddings of its MotionCLIP: not scaled by 2.5 and not cut at 0 as the
    CLIPScore of images is (Hessel et al. 2021). Raises `ValueError` for unequal shapes, no pairs, rows that are zero or
    not finite. Source: neu-vi/MARDM @ 443313b, utils/eval_utils.py, evaluation_mardm.
    """
    if queries.shape != candidates.shape:
        raise ValueError(f"queries are {queries.shape}, candidates {candidates.shape}: one of either for each pair")
    units = []
    for name, rows in (("queries", queries), ("candidates", candidates)):
        values = checked_features(rows, name, minimum=1)
        lengths = np.linalg.norm(values, axis=1, keepdims=True)
        if not (lengths > 0).all():
            raise ValueError(f"{name}: an embedding of length 0 has no direction")
        units.append(values / lengths)
    return float(np.einsum("ij,ij->i", *units).mean())


CLIP_SCORE = Metric(
    "clip_score", "CLIP-score", "", True, "MARDM (Meng et al. 2024)", "queries, candidates", clip_score, by_frames
)


def tmr_score(queries: Float[np.ndarray, "pairs numbers"], candidates: Float[np.ndarray, "pairs numbers"]) -> float:
    """½ + ½ · `clip_score`: the score of pairs in TMR's code and in Kimodo's (kimodo/metrics/tmr.py), 0 to 1."""
    return 0.5 + 0.5 * clip_score(queries, candidates)


TMR_SCORE = Metric(
    "tmr_score", "TMR score", "", True, "TMR; Kimodo (Rempe et al. 2026)", "queries, candidates", tmr_score, by_frames
)


def cosines(
    a: Float[np.ndarray, "rows numbers"], b: Float[np.ndarray, "others numbers"]
) -> Float64[np.ndarray, "rows others"]:
    """Cosines of the angles between all rows. Raises `ValueError` for a row of zeros."""
    x, y = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    lengths = np.linalg.norm(x, axis=1), np.linalg.norm(y, axis=1)
    if not all((each > 0).all() for each in lengths):
        raise ValueError("a row of zeros has no direction")
    return np.asarray((x / lengths[0][:, None]) @ (y / lengths[1][:, None]).T)


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
