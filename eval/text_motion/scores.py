"""Text-to-motion scores from embeddings of texts, of real and of generated motions."""

from collections.abc import Callable, Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from eval.metrics.actions import diversity, multimodality, multimodality_shared_pairs
from eval.metrics.distributions import Gaussian, fid_infinity, fit_gaussian, frechet_distance, kid
from eval.metrics.number import Scores
from eval.metrics.retrieval import clip_score, pool_distances, ranked_both_ways, tmr_score
from eval.text_motion.pairs import AddTerms, PairTerms, TextMotionPairs, resampled_multimodality
from eval.text_motion.protocol import TextMotionProtocol
from motionkit.core.shapes import Float, Int64

PAIR_SCORES = {"clip_score": clip_score, "tmr_score": tmr_score}
GENERATED, REAL, DIVERSITY, MULTIMODALITY = range(4)
"""Random streams of one replication, so that a metric's draws do not affect another's."""

Order = Int64[np.ndarray, "_chosen"]


def score_text_motion(
    real: TextMotionPairs,
    draws: Sequence[TextMotionPairs],
    protocol: TextMotionProtocol,
    seed: int,
    *,
    repeated: Float[np.ndarray, "texts generations features"] | None = None,
    pair_score: str = "",
    on_replication: Callable[[], None] = lambda: None,
) -> Scores:
    """R-Precision in both directions, MM-Dist, FID, Diversity and MultiModality of generated motions by a protocol.

    `draws` are independent generations of the whole set; replication r takes draw r modulo their number, so with fewer
    draws than replications the interval covers less than the protocol's, and a remark says so. `repeated` holds several
    motions of one text for MultiModality, which is left out without it. With the protocol's reference "paired", row i
    of a draw was generated for the text of row i of `real`. To score real motion itself give `[real]`: its FID is then
    0, or what the dropped remainders leave ("redraw"). `pair_score` is a metric of pairs of embeddings of length 1.

    Raises `ValueError` for pairs that do not fit together or are not finite, and fewer than a pool of them.
    """
    if not draws:
        raise ValueError("there is no set of motions to score")
    for draw in draws:
        _check(real, draw, protocol)
    scores, fids, terms = Scores(remarks=list(protocol.remarks)), _Fids(real, draws, protocol), PairTerms(draws)
    # As in `fid`: a single BLAS thread is the fastest for matrices of this size.
    with threadpool_limits(1, "blas"):
        for replication in range(protocol.replications):
            which = replication % len(draws)
            draw = draws[which]
            order = np.random.default_rng((seed, replication, GENERATED)).permutation(len(draw.motions))
            order = order[: _counted(len(order), protocol)]
            _add_precision(draw, order, protocol, scores, terms.of_draw(which))
            scores.add("fid", fids.value(which, order, seed, replication))
            rng = np.random.default_rng((seed, replication, DIVERSITY))
            if pair_score:
                scores.add(pair_score, PAIR_SCORES[pair_score](draw.texts[order], draw.motions[order]))
            scores.add("diversity", diversity(draw.motions[order], rng, protocol.diversity_pairs))
            if repeated is not None and replication < protocol.multimodality.replications:
                _add_multimodality(
                    repeated, protocol, np.random.default_rng((seed, replication, MULTIMODALITY)), scores
                )
            on_replication()
        _add_details(real, draws[0], protocol, seed, scores)
        if pair_score:
            scores.resampled[pair_score] = terms.resampled_mean(PAIR_SCORES[pair_score])
        scores.resampled |= terms.resampled(real) | resampled_multimodality(repeated, protocol.multimodality.metric)
    scores.remark_on_draws(len(draws), protocol.replications)
    scores.sizes = {"real": fids.num_real, "generated": _counted(len(draws[0].motions), protocol), "draws": len(draws)}
    _remark_on_sizes(real.motions.shape[1], protocol, scores)
    if repeated is not None:
        scores.sizes |= {"multimodality texts": len(repeated), "multimodality generations": repeated.shape[1]}
    return scores


def _check(real: TextMotionPairs, draw: TextMotionPairs, protocol: TextMotionProtocol) -> None:
    if draw.motions.shape[1] != real.motions.shape[1]:
        raise ValueError(
            f"embeddings of real motions have {real.motions.shape[1]} numbers, "
            f"of generated ones {draw.motions.shape[1]}"
        )
    if len(draw.motions) < protocol.pool:
        raise ValueError(
            f"{len(draw.motions)} motions: a text chooses among {protocol.pool} (protocol {protocol.name!r}), so there "
            "must be that many at least"
        )
    if protocol.reference == "paired" and len(draw.motions) != len(real.motions):
        raise ValueError(
            f"protocol {protocol.name!r} compares with the real motions of the same texts, but there are "
            f"{len(draw.motions)} generated and {len(real.motions)} real motions: give those that belong together, or "
            "choose a protocol with an independent reference (t2m, mdm)"
        )


def _counted(number: int, protocol: TextMotionProtocol) -> int:
    """Number of generated motions used."""
    return _kept(number if protocol.num_motions is None else min(number, protocol.num_motions), protocol)


def _kept(number: int, protocol: TextMotionProtocol) -> int:
    return number if protocol.remainder == "R-Precision" else number // protocol.pool * protocol.pool


def _add_precision(
    draw: TextMotionPairs,
    order: Order,
    protocol: TextMotionProtocol,
    scores: Scores,
    terms: AddTerms,
) -> None:
    distances = pool_distances(draw.texts, draw.motions, order, protocol.pool)
    found = ranked_both_ways(distances)
    terms(distances, order)
    for suffix, direction in (("", found.text_asks), ("_motion_asks", found.motion_asks)):
        for rank, share in enumerate(direction.top.tolist(), start=1):
            scores.add(f"r_precision_top{rank}{suffix}", share)
    scores.add("mm_dist", found.text_asks.matching_distance)


class _Fids:
    """FID of each replication; constant parts are fitted once."""

    def __init__(self, real: TextMotionPairs, draws: Sequence[TextMotionPairs], protocol: TextMotionProtocol) -> None:
        self._real, self._draws, self._protocol = real.motions, draws, protocol
        self._whole: dict[int | None, Gaussian] = {}
        self._of_draws: dict[int, float] = {}
        self.num_real = 0

    def value(self, which: int, order: Order, seed: int, replication: int) -> float:
        """FID of the chosen motions of one draw against the protocol's reference."""
        reference = self._reference(order, seed, replication)
        self.num_real = len(self._real) if reference is None else len(reference)
        fixed = reference is None and len(order) == len(self._draws[which].motions)
        if fixed and which in self._of_draws:
            return self._of_draws[which]
        distance = frechet_distance(self._gaussian(reference), self._gaussian_of(which, order))
        if fixed:
            self._of_draws[which] = distance
        return distance

    def _reference(self, order: Order, seed: int, replication: int) -> Order | None:
        """Rows of the real set in the reference; None for all."""
        everything = len(self._real)
        if self._protocol.reference == "whole":
            return None
        if self._protocol.reference == "paired":
            return None if len(order) == everything else order
        kept = _kept(everything, self._protocol)
        if kept == everything:
            return None
        return np.random.default_rng((seed, replication, REAL)).permutation(everything)[:kept]

    def _gaussian(self, rows: Order | None) -> Gaussian:
        return self._all(None, self._real) if rows is None else fit_gaussian(self._real[rows])

    def _gaussian_of(self, which: int, order: Order) -> Gaussian:
        motions = self._draws[which].motions
        return self._all(which, motions) if len(order) == len(motions) else fit_gaussian(motions[order])

    def _all(self, key: int | None, features: Float[np.ndarray, "samples features"]) -> Gaussian:
        if key not in self._whole:
            self._whole[key] = fit_gaussian(features)
        return self._whole[key]


def _add_multimodality(
    repeated: Float[np.ndarray, "texts generations features"],
    protocol: TextMotionProtocol,
    rng: np.random.Generator,
    scores: Scores,
) -> None:
    rule = protocol.multimodality
    texts, generations = repeated.shape[:2]
    needed = 2 * rule.num_pairs if rule.pairs == "distinct" else rule.num_pairs
    if generations < needed:
        scores.remark(
            f"MultiModality is left out: {rule.num_pairs} pairs need {needed} motions of each text, "
            f"there are {generations}"
        )
        return
    if generations != rule.num_generations or (rule.num_texts is not None and texts < rule.num_texts):
        asked = "every text" if rule.num_texts is None else f"{rule.num_texts} texts"
        scores.remark(
            f"protocol {protocol.name!r} asks {rule.num_generations} motions of {asked} for MultiModality; here are "
            f"{generations} motions of {texts} texts"
        )
    chosen = repeated
    if rule.num_texts is not None and texts > rule.num_texts:
        chosen = repeated[rng.choice(texts, size=rule.num_texts, replace=False)]
    chosen = chosen[:, : rule.num_generations]
    function = multimodality if rule.pairs == "distinct" else multimodality_shared_pairs
    scores.add(rule.metric, function(chosen, rng=rng, num_pairs=rule.num_pairs))


def _add_details(
    real: TextMotionPairs, draw: TextMotionPairs, protocol: TextMotionProtocol, seed: int, scores: Scores
) -> None:
    """FID_∞ and KID of the first draw only: they cost more than everything else, and draw no pools or pairs."""
    if real is draw:
        return
    if "fid_infinity" in protocol.details:
        try:
            rng = np.random.default_rng(seed)
            scores.add("fid_infinity", fid_infinity(real.motions, draw.motions, rng))
        except ValueError as error:
            scores.remark(f"FID∞ is left out: {error}")
    if "kid" in protocol.details:
        scores.add("kid", kid(real.motions, draw.motions))


def _remark_on_sizes(features: int, protocol: TextMotionProtocol, scores: Scores) -> None:
    sizes = scores.sizes
    if protocol.num_motions is not None and sizes["generated"] < protocol.num_motions:
        scores.remark(
            f"protocol {protocol.name!r} counts {protocol.num_motions:,} generated motions, here are "
            f"{sizes['generated']:,}: FIDs of different N do not compare"
        )
    least = min(sizes["real"], sizes["generated"])
    if least <= features:
        scores.remark(
            f"N = {least} for {features} features: FID is that of two degenerate Gaussians and says little; read KID"
        )
    if sizes["generated"] < protocol.diversity_pairs:
        scores.remark(f"Diversity pairs {sizes['generated']} motions, not {protocol.diversity_pairs}")
