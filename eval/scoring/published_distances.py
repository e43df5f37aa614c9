"""R-Precision as published code computes it: √(a² + b² − 2ab) in float32, and what it makes of NaN."""

import numpy as np
from jaxtyping import Float, Float32, Int64

from eval.metrics.r_precision import RANKS, BothWays, RPrecision
from eval.protocols.compat import NAN_IS_BEST


def ranked_as_published(
    texts: Float[np.ndarray, "pairs numbers"],
    motions: Float[np.ndarray, "pairs numbers"],
    order: Int64[np.ndarray, "chosen"],
    pool: int,
    bug: str,
) -> BothWays:
    """R-Precision and MM-Dist of pools cut from the pairs in `order`, with a bug of `eval.protocols.compat`.

    "float32-distances": a rounding error below zero under the root gives NaN, which ranks last and makes MM-Dist NaN.
    "nan-is-best": the same NaN becomes 0, the nearest of all. Ties go to the candidate that comes first. The random
    order, float64 sums and exact counts are this project's. Source: text-to-motion utils/metrics.py; MLD tm2t.py.
    """
    if len(order) < pool:
        raise ValueError(f"R-Precision in pools of {pool} needs at least {pool} pairs, there are {len(order)}")
    pools = order[: len(order) // pool * pool].reshape(-1, pool)
    distances = np.stack([_float32_distances(texts[members], motions[members]) for members in pools])
    if bug == NAN_IS_BEST.name:
        distances = np.nan_to_num(distances)
    return BothWays(_ranked(distances), _ranked(distances.swapaxes(1, 2)))


def _float32_distances(
    texts: Float[np.ndarray, "pool numbers"], motions: Float[np.ndarray, "pool numbers"]
) -> Float32[np.ndarray, "pool pool"]:
    a, b = texts.astype(np.float32), motions.astype(np.float32)
    squared = np.float32(-2) * (a @ b.T) + np.square(a).sum(axis=1)[:, None] + np.square(b).sum(axis=1)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.sqrt(squared), dtype=np.float32)


def _ranked(distances: Float32[np.ndarray, "pools pool pool"]) -> RPrecision:
    """Ranks by a stable sort, NaN last."""
    place = np.argsort(distances, axis=-1, kind="stable")
    rank = (place == np.arange(distances.shape[1])[None, :, None]).argmax(axis=-1)
    top = np.array([(rank < limit).mean() for limit in range(1, RANKS + 1)])
    own = np.diagonal(distances, axis1=1, axis2=2)
    return RPrecision(top, float(own.astype(np.float64).mean()), own.size)
