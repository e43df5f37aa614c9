"""R-Precision: how often a sentence's own motion is among the nearest in a pool (text-to-motion, final_evaluations.py).

The reference protocol ranks, for each text, the motions of its pool; the NeRM paper describes the reverse, for each
motion its texts. Both come from one matrix of distances per pool; a table says which it used.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

from eval.metrics.metric import Metric
from motionkit.core.shapes import Float, Float64, Int64

REFERENCE_POOL = 32
RANKS = 3


@dataclass(frozen=True, eq=False)
class RPrecision:
    """`top[k − 1]`: share of queries whose own candidate is among the k nearest; `matching_distance`: its mean."""

    top: Float64[np.ndarray, "ranks"]
    matching_distance: float
    num_queries: int

    def merged(self, other: "RPrecision") -> "RPrecision":
        """The result over the pools of both; every query has the same weight."""
        total = self.num_queries + other.num_queries
        share, rest = self.num_queries / total, other.num_queries / total
        distance = share * self.matching_distance + rest * other.matching_distance
        return RPrecision(share * self.top + rest * other.top, distance, total)


@dataclass(frozen=True, eq=False)
class BothWays:
    """R-Precision of the same pools in both directions; the matching distance is the same in both."""

    text_asks: RPrecision
    motion_asks: RPrecision


def r_precision(
    queries: Float[np.ndarray, "pairs numbers"],
    candidates: Float[np.ndarray, "pairs numbers"],
    *,
    rng: np.random.Generator,
    pool: int = REFERENCE_POOL,
    ranks: int = RANKS,
) -> RPrecision:
    """Shuffle the pairs, cut them into pools, and rank each query's own candidate by Euclidean distance in its pool.

    Row i of `queries` belongs to row i of `candidates`. The last, incomplete pool is dropped, as in the reference.
    Candidates at the same distance share their ranks: each hit counts by its expectation over random order, so an
    evaluator that maps everything to one point scores chance. Distances are exact, in float64 (the usual
    √(a² + b² − 2ab) in float32 gives NaN for equal vectors); `matching_distance` is MM-Dist over the same pairs.
    Raises `ValueError` for fewer pairs than a pool or rows that are not finite.
    """
    return ranked(pool_distances(queries, candidates, rng.permutation(len(queries)), pool), ranks)


R_PRECISION = tuple(
    Metric(
        f"r_precision_top{rank}{suffix}",
        f"R-Precision, top {rank}{title}",
        "",
        True,
        source,
        "queries, candidates",
        r_precision,
    )
    for suffix, title, source in (
        ("", "", "text-to-motion (Guo et al. 2022): a text asks for its motion"),
        ("_motion_asks", " (a motion asks)", "NeRM, appendix: a motion asks for its text"),
    )
    for rank in range(1, RANKS + 1)
)
MM_DIST = Metric(
    "mm_dist", "MultiModal Dist", "", False, "text-to-motion (Guo et al. 2022)", "queries, candidates", r_precision
)


def r_precision_both_ways(
    texts: Float[np.ndarray, "pairs numbers"],
    motions: Float[np.ndarray, "pairs numbers"],
    *,
    rng: np.random.Generator,
    pool: int = REFERENCE_POOL,
    ranks: int = RANKS,
) -> BothWays:
    """`r_precision` with texts as queries and with motions as queries, from the same pools."""
    return ranked_both_ways(pool_distances(texts, motions, rng.permutation(len(texts)), pool), ranks)


def pool_distances(
    queries: Float[np.ndarray, "pairs numbers"],
    candidates: Float[np.ndarray, "pairs numbers"],
    order: Int64[np.ndarray, "chosen"],
    pool: int = REFERENCE_POOL,
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


def hits(
    distances: Float64[np.ndarray, "pools pool pool"], ranks: int = RANKS
) -> Float64[np.ndarray, "ranks pools pool"]:
    """Whether each query's (row's) own candidate is among the 1, 2, … nearest; ties share the hit."""
    own = np.diagonal(distances, axis1=1, axis2=2)
    nearer = (distances < own[..., None]).sum(axis=-1)
    tied = (distances == own[..., None]).sum(axis=-1)
    return np.stack([np.clip((rank - nearer) / tied, 0.0, 1.0) for rank in range(1, ranks + 1)])


def ranked(distances: Float64[np.ndarray, "pools pool pool"], ranks: int = RANKS) -> RPrecision:
    """R-Precision from pools' distances with queries as rows."""
    own = np.diagonal(distances, axis1=1, axis2=2)
    top = np.array([found.mean() for found in hits(distances, ranks)])
    return RPrecision(top, float(own.mean()), own.size)


def ranked_both_ways(distances: Float64[np.ndarray, "pools texts motions"], ranks: int = RANKS) -> BothWays:
    """R-Precision in both directions from pools' distances with texts as rows and motions as columns."""
    return BothWays(ranked(distances, ranks), ranked(distances.swapaxes(1, 2), ranks))
