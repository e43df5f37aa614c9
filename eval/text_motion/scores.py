"""Text-to-motion scores from embeddings of texts, of real and of generated motions, and their bootstrap over takes."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.spatial.distance import cdist
from threadpoolctl import threadpool_limits

from eval.metrics import intervals, retrieval
from eval.metrics.actions import NUM_PAIRS, diversity, multimodality, multimodality_shared_pairs
from eval.metrics.actions import PAIRS as DIVERSITY_PAIRS
from eval.metrics.distributions import fid_infinity, fit_gaussian, frechet_distance, kid
from eval.text_motion.protocol import NUM_GENERATIONS, RetrievalRule, TextMotionProtocol
from motionkit.core.shapes import Bool, Float, Float64, Int64

Sentences = Float[np.ndarray, "pairs numbers"]
Repeated = Float[np.ndarray, "texts generations features"]
PAIR_SCORES = {"clip_score": retrieval.clip_score, "tmr_score": retrieval.tmr_score}
GENERATED, REAL, DIVERSITY, MULTIMODALITY, RETRIEVAL = 0, 1, 2, 3, 9
"""Random streams, so that a metric's draws do not affect another's."""
SUFFIXES = {
    "text asks for motion": "",
    "motion asks for text": "_motion_asks",
    "motion asks for real motion": "_real_asked",
}


@dataclass(frozen=True, eq=False)
class TextMotionPairs:
    """Embeddings of texts and of the motions that belong to them, row by row, in one space.

    `takes` name the real take of each pair, which intervals resample.
    """

    texts: Float[np.ndarray, "pairs numbers"]
    motions: Float[np.ndarray, "pairs numbers"]
    takes: tuple[str, ...]

    def select(self, rows: Int64[np.ndarray, "chosen"]) -> "TextMotionPairs":
        """Some of the pairs, in the order of `rows`."""
        takes = tuple(self.takes[row] for row in rows.tolist())
        return TextMotionPairs(self.texts[rows], self.motions[rows], takes)


class PairTerms:
    """R-Precision and MM-Dist of every pair of some draws over all replications, and the take of each pair."""

    def __init__(self, draws: Sequence[TextMotionPairs]) -> None:
        self._draws, self._takes = draws, [draw.takes for draw in draws]
        self._units = intervals.units_of_draws(self._takes)
        self._values: dict[str, list[Float64[np.ndarray, _queries]]] = defaultdict(list)
        self._rows: list[Int64[np.ndarray, _queries]] = []

    def add(self, which: int, order: Int64[np.ndarray, "chosen"], pool: int, scores: intervals.Scores) -> None:
        """Rank the pairs of one draw in pools that are cut from `order`; add a replication to `scores`."""
        draw, first = self._draws[which], sum(len(each.motions) for each in self._draws[:which])
        distances = retrieval.pool_distances(draw.texts, draw.motions, order, pool)
        values = {"mm_dist": np.diagonal(distances, axis1=1, axis2=2)}
        for suffix, directed in (("", distances), ("_motion_asks", distances.swapaxes(1, 2))):
            for rank, shares in enumerate(retrieval.hits(directed), start=1):
                values[f"r_precision_top{rank}{suffix}"] = shares
        for name, own in values.items():
            scores.add(name, float(own.mean()))
            self._values[name].append(own.ravel())
        self._rows.append(first + order[: len(order) // pool * pool])

    def resampled_means(self) -> dict[str, intervals.Resampled]:
        """R-Precision and MM-Dist in the bootstrap over takes."""
        unit, weights = self._units.unit[np.concatenate(self._rows)], self._units.weights()
        values = {name: np.concatenate(each) for name, each in self._values.items()}
        return {name: intervals.weighted_means(each, unit, weights) for name, each in values.items()}

    def resampled(self, real: TextMotionPairs, pair_score: str) -> dict[str, intervals.Resampled]:
        """Every metric in the bootstrap over takes; none if there is a single take."""
        if len(set(self._units.takes)) < 2:
            return {}
        unit, weights = self._units.unit, self._units.weights()
        motions = np.concatenate([draw.motions for draw in self._draws]).astype(np.float64)
        values = self.resampled_means() | {
            "fid": intervals.resampled_fid(real.motions.astype(np.float64), real.takes, motions, self._takes),
            "diversity": intervals.resampled_mean_distance(motions, unit, weights),
        }
        if pair_score:
            pairs = [pair for draw in self._draws for pair in zip(draw.texts, draw.motions, strict=True)]
            of_pairs = np.array([PAIR_SCORES[pair_score](text[None], motion[None]) for text, motion in pairs])
            values[pair_score] = intervals.weighted_means(of_pairs, unit, weights)
        return values


def score_text_motion(
    real: TextMotionPairs,
    draws: Sequence[TextMotionPairs],
    protocol: TextMotionProtocol,
    seed: int,
    *,
    repeated: Repeated | None = None,
    pair_score: str = "",
) -> intervals.Scores:
    """R-Precision in both directions, MM-Dist, FID, Diversity and MultiModality of generated motions by a protocol.

    `draws` are independent generations of the whole set; replication r takes draw r modulo their number, so with fewer
    draws than replications the interval covers less than the protocol's, and a remark says so. `repeated` holds several
    motions of one text for MultiModality, which is left out without it. With the protocol's reference "paired", row i
    of a draw was generated for the text of row i of `real`. To score real motion itself give `[real]`: its FID is then
    0, or what the dropped remainders leave ("redraw"). `pair_score` is a metric of pairs of embeddings of length 1.

    Raises `ValueError` for pairs that do not fit together or are not finite, and fewer than a pool of them.
    """
    if protocol.reference == "paired" and any(len(draw.motions) != len(real.motions) for draw in draws):
        raise ValueError(
            f"protocol {protocol.name!r} compares with the real motions of the same texts, but there are "
            f"{len(draws[0].motions)} generated and {len(real.motions)} real ones: choose another protocol (t2m, mdm)"
        )
    scores, terms = intervals.Scores(remarks=list(protocol.remarks)), PairTerms(draws)

    @cache  # whole sets are compared once
    def fid(which: int, rows: bytes, real_rows: bytes) -> float:
        generated, reference = (np.frombuffer(each, np.int64) for each in (rows, real_rows))
        return frechet_distance(fit_gaussian(real.motions[reference]), fit_gaussian(draws[which].motions[generated]))

    # As in `fid`: a single BLAS thread is the fastest for matrices of this size.
    with threadpool_limits(1, "blas"):
        for replication in range(protocol.replications):
            which = replication % len(draws)
            draw = draws[which]
            order = np.random.default_rng((seed, replication, GENERATED)).permutation(len(draw.motions))
            order = order[: _num_used(len(order), protocol.num_motions, protocol)]
            terms.add(which, order, protocol.pool, scores)
            reference = order
            if protocol.reference != "paired":
                reference = np.random.default_rng((seed, replication, REAL)).permutation(len(real.motions))
            if protocol.reference == "redraw":
                reference = reference[: _num_used(len(reference), None, protocol)]
            scores.add("fid", fid(which, np.sort(order).tobytes(), np.sort(reference).tobytes()))
            if pair_score:
                scores.add(pair_score, PAIR_SCORES[pair_score](draw.texts[order], draw.motions[order]))
            rng = np.random.default_rng((seed, replication, DIVERSITY))
            scores.add("diversity", diversity(draw.motions[order], rng))
        scores.sizes = {"real": len(reference), "generated": len(order)}
        if repeated is not None:
            _add_multimodality(repeated, protocol, seed, scores)
        if real is not draws[0]:  # once: they cost more than everything else, and draw no pools or pairs
            if "fid_infinity" in protocol.details:
                try:
                    limit = fid_infinity(real.motions, draws[0].motions, np.random.default_rng(seed))
                    scores.add("fid_infinity", limit)
                except ValueError as error:
                    scores.remark(f"FID∞ is left out: {error}")
            if "kid" in protocol.details:
                scores.add("kid", kid(real.motions, draws[0].motions))
        scores.resampled |= terms.resampled(real, pair_score)
    scores.remark_on_draws(len(draws), protocol.replications)
    generated, features = scores.sizes["generated"], real.motions.shape[1]
    if protocol.num_motions is not None and generated < protocol.num_motions:
        scores.remark(
            f"protocol {protocol.name!r} counts {protocol.num_motions:,} generated motions, here are {generated:,}: "
            "FIDs of different N do not compare"
        )
    if (least := min(scores.sizes["real"], generated)) <= features:
        scores.remark(
            f"N = {least} for {features} features: FID is that of two degenerate Gaussians and says little; read KID"
        )
    if generated < DIVERSITY_PAIRS:
        scores.remark(f"Diversity pairs {generated} motions, not {DIVERSITY_PAIRS}")
    return scores


def _num_used(number: int, most: int | None, protocol: TextMotionProtocol) -> int:
    """Number of motions used, of at most `most`: all, or all whole pools."""
    number = number if most is None else min(number, most)
    return number if protocol.remainder == "R-Precision" else number // protocol.pool * protocol.pool


def _add_multimodality(repeated: Repeated, protocol: TextMotionProtocol, seed: int, scores: intervals.Scores) -> None:
    """MultiModality over the replications of its rule, and its bootstrap over texts."""
    rule, (texts, generations) = protocol.multimodality, repeated.shape[:2]
    scores.sizes |= {"multimodality texts": texts, "multimodality generations": generations}
    function = multimodality if rule.pairs == "distinct" else multimodality_shared_pairs
    needed = 2 * NUM_PAIRS if rule.pairs == "distinct" else NUM_PAIRS
    if generations < needed:
        scores.remark(f"MultiModality is left out: it needs {needed} motions of each text, there are {generations}")
    elif generations != NUM_GENERATIONS or texts < (rule.num_texts or 0):
        of_texts = "every text" if rule.num_texts is None else f"{rule.num_texts} texts"
        scores.remark(
            f"the protocol has {NUM_GENERATIONS} motions of {of_texts} for MultiModality; here are {generations} "
            f"motions of {texts} texts"
        )
    for replication in range(min(rule.replications, protocol.replications) if generations >= needed else 0):
        rng, chosen = np.random.default_rng((seed, replication, MULTIMODALITY)), repeated[:, :NUM_GENERATIONS]
        if rule.num_texts is not None and texts > rule.num_texts:
            chosen = chosen[rng.choice(texts, size=rule.num_texts, replace=False)]
        scores.add(rule.metric, function(chosen, rng=rng))
    if min(texts, generations) > 1:
        distances = np.linalg.norm(repeated - np.roll(repeated, 1, axis=1), axis=-1).mean(axis=1)
        weights = intervals.resampling_weights([f"text {number}" for number in range(texts)])
        scores.resampled[rule.metric] = intervals.weighted_means(distances, np.arange(texts), weights)


def score_retrieval(
    real: TextMotionPairs,
    draws: Sequence[TextMotionPairs],
    rule: RetrievalRule,
    sentences: Sentences,
    seed: int,
    distance: Callable[..., Float[np.ndarray, "queries candidates"]] = cdist,
) -> dict[str, intervals.Number]:
    """Recalls and median ranks by their names in `eval.metrics.metric`, means over the draws (and over pools).

    Row i of every draw was generated for text i, whose real motion is row i of `real` and whose sentence embedding, of
    an independent encoder, is row i of `sentences`. Candidates are ranked by `distance`, Euclidean by default: of
    embeddings of length 1 that is the order of cosines. Raises `ValueError` for fewer pairs than a pool.
    """
    values: dict[str, list[float]] = {}
    for draw in draws:
        same = _same_texts(rule, draw, sentences)
        for rows in _ranked_together(rule, sentences, seed):
            sides = {
                "text asks for motion": (draw.texts, draw.motions),
                "motion asks for text": (draw.motions, draw.texts),
                "motion asks for real motion": (draw.motions, real.motions),
            }
            for direction in rule.directions:
                queries, candidates = (side[rows] for side in sides[direction])
                relevant = None if same is None else same[np.ix_(rows, rows)]
                recall, median_rank = retrieval.retrieval(distance(queries, candidates), relevant)
                suffix = SUFFIXES[direction]
                for rank, share in zip(retrieval.RECALL_RANKS, recall.tolist(), strict=True):
                    values.setdefault(f"recall_at_{rank}{suffix}", []).append(share)
                values.setdefault(f"median_rank{suffix}", []).append(median_rank)
    return {name: intervals.over_replications(each) for name, each in values.items()}


def share_of_same_texts(rule: RetrievalRule, pairs: TextMotionPairs, sentences: Sentences) -> float:
    """Mean fraction of the other texts that count as the same by the rule, which chance gains from."""
    same = _same_texts(rule, pairs, sentences)
    number = len(pairs.texts)
    return 0.0 if same is None or number < 2 else float((same.sum() - number) / (number * (number - 1)))


def _same_texts(
    rule: RetrievalRule, draw: TextMotionPairs, sentences: Sentences
) -> Bool[np.ndarray, "pairs pairs"] | None:
    """Which pairs have the same text by the rule, and so are relevant to each other; None for a pair's own alone."""
    if rule.same_above is None:
        return None
    texts = sentences if rule.same_by == "sentences" else draw.texts
    same = retrieval.cosines(texts, texts) > 2.0 * rule.same_above - 1.0
    np.fill_diagonal(same, True)
    return same


def _ranked_together(rule: RetrievalRule, sentences: Sentences, seed: int) -> list[Int64[np.ndarray, "_rows"]]:
    number = len(sentences)
    if rule.pool is not None:
        if number < rule.pool:
            raise ValueError(f"{rule.name}: {number} pairs do not fill a pool of {rule.pool}")
        order = np.random.default_rng((seed, RETRIEVAL)).permutation(number)
        return list(order[: number // rule.pool * rule.pool].reshape(-1, rule.pool))
    if rule.least_similar is not None:
        return [retrieval.least_similar(retrieval.cosines(sentences, sentences), rule.least_similar)]
    return [np.arange(number)]
