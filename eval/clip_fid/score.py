"""clip-FID as this project defines it: a distance between features of random native-rate clips.

The NeRM paper (§4.2) compares random clips of m poses at framerate s around a centre v, real against generated, without
resampling either; m, the number of clips, the extractor and the real set at a target rate are this project's choices,
and `VERSION` is raised whenever one of them changes. Not the FID of images on CLIP features that other tools call
clip-FID.
"""

from collections.abc import Callable, Hashable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
import numpy.typing as npt

from eval.clip_fid.clips import (
    OTHER,
    REAL,
    ClipError,
    FeatureSet,
    Protocol,
    describe_clips,
    draw_clips,
    place_clips,
    readable,
)
from eval.clip_fid.threads import in_threads
from eval.metrics.distributions import (
    RealManifold,
    fid_infinity,
    fit_gaussian,
    frechet_distance,
    kid,
)
from eval.metrics.metric import Metric
from eval.metrics.number import (
    Number,
    Resampled,
    Resampling,
    Units,
    UnitSums,
    blocks_for,
    over_replications,
    resampled_fids,
    units_of,
)
from eval.sets.sets import SampleSet
from motionkit.core.shapes import Float64, Int64

VERSION = "clip-fid/3"


RowKey = TypeVar("RowKey", bound=Hashable)


def score_rows(
    real: SampleSet,
    rows: Mapping[RowKey, SampleSet],
    features: FeatureSet,
    protocol: Protocol,
    on_replication: Callable[[], None] = lambda: None,
    subset_sizes: Mapping[RowKey, int] | None = None,
) -> dict[RowKey, Number]:
    """clip-FID of every row's sample set against the real one at the same framerate.

    Intervals are over takes (and generations, if there are several) and the drawing of clips; `Number.drawing` is of
    clips alone. `Number.details` has fid_infinity, kid, precision, recall, density and coverage: empty without detailed
    replications, no fid_infinity with too few clips. There are no resamplings if the protocol has none, or either side
    has a single take.

    `on_replication` is called after each replication. For rows in `subset_sizes` every replication takes another random
    subset of that many sequences; their interval is 1.96 standard deviations of single subsets, not of their mean.
    Raises `ClipError` if clips do not fit or the real set's features are constant, and `ValueError` for different
    framerates.
    """
    subsets = subset_sizes or {}
    for samples in rows.values():
        if samples.fps != real.fps:
            raise ValueError(f"{samples.name} is at {samples.fps} fps, the real set at {real.fps}")
    real, rows = readable(real, features), {name: readable(samples, features) for name, samples in rows.items()}

    def replicate(replication: int) -> _Replication[RowKey]:
        reference = _features(real, features, protocol, replication, REAL)
        if (reference.features == reference.features[0]).all():
            raise ClipError(
                f"{real.name} at {real.fps} fps: every clip has the same {features.name} features, so there is no "
                "distribution to compare with; is the motion frozen?"
            )
        detailed = replication < protocol.detailed_replications and bool(rows)
        manifold = RealManifold(reference.features, protocol.num_neighbours) if detailed else None
        scores, described = {}, [reference]
        for name, samples in rows.items():
            among = _subset(samples, subsets[name], protocol, replication) if name in subsets else None
            other = _features(samples, features, protocol, replication, OTHER, among)
            scores[name] = _compare(reference.features, other.features, protocol, replication, manifold)
            if among is None:
                described.append(other)
        return _Replication(scores, described)

    whole = [name for name in rows if name not in subsets]
    takes = _Takes([real, *(rows[name] for name in whole)], protocol) if protocol.resamplings else None
    replications = []
    for each in in_threads(replicate, range(protocol.replications)):
        replications.append(each.scores)
        if takes is not None:
            takes.add(each.described)
        on_replication()
    resampled = {} if takes is None else dict(zip(whole, takes.scores(), strict=True))
    found = {}
    for name in rows:
        summary = _summarise([scores[name] for scores in replications], resampled.get(name, ()))
        found[name] = _of_single_sets(summary, protocol) if name in subsets else summary
    return found


CLIP_FID = Metric(
    "clip_fid",
    "clip-FID",
    "",
    False,
    f"NeRM §4.2, as {VERSION}",
    score_rows,
    calibration="motionkit eval --calibrate",
)


def score_disjoint_halves(
    real: SampleSet,
    features: FeatureSet,
    protocol: Protocol,
    on_replication: Callable[[], None] = lambda: None,
) -> Number:
    """clip-FID between random disjoint halves of the real takes (P2), one split per replication.

    The interval is 1.96 standard deviations of single splits.
    """
    real = readable(real, features)

    def replicate(replication: int) -> dict[str, float]:
        halves = _split_takes(real, np.random.default_rng((protocol.seed, replication, 3)))
        a, b = (
            _features(real, features, protocol, replication, side, half).features
            for side, half in zip((REAL, OTHER), halves, strict=True)
        )
        detailed = replication < protocol.detailed_replications
        manifold = RealManifold(a, protocol.num_neighbours) if detailed else None
        return _compare(a, b, protocol, replication, manifold)

    replications = []
    for scores in in_threads(replicate, range(protocol.replications)):
        replications.append(scores)
        on_replication()
    return _of_single_sets(_summarise(replications), protocol)


@dataclass(frozen=True, eq=False)
class _Described:
    """Features of clips, and each clip's sequence."""

    features: Float64[np.ndarray, "clips features"]
    sequence: Int64[np.ndarray, "clips"]


@dataclass(frozen=True, eq=False)
class _Replication(Generic[RowKey]):
    """Scores of every row; the real set's clips, then every row's."""

    scores: Mapping[RowKey, dict[str, float]]
    described: list[_Described]


class _Takes:
    """Statistics of each take of a comparison's sets, the real one first, from the clips of all replications."""

    def __init__(self, sets: list[SampleSet], protocol: Protocol) -> None:
        self._sets, self._resampling = sets, Resampling(protocol.resamplings, protocol.seed)
        self._units: list[Units] = []
        self._sums: list[UnitSums] = []

    def add(self, described: list[_Described]) -> None:
        """The clips of one replication of every set."""
        if not self._sums:
            centre = described[0].features.mean(axis=0)
            most = self._sets[0].num_takes
            for each in self._sets:
                blocks = blocks_for(max(most, each.num_takes), centre.size)
                self._units.append(units_of(each.take_names, each.generations, blocks))
                self._sums.append(UnitSums(len(self._units[-1].takes), centre))
        for clips, units, sums in zip(described, self._units, self._sums, strict=True):
            sums.add(clips.features, units.unit[clips.sequence])

    def scores(self) -> list[Resampled]:
        """Every row's bootstrap scores; empty if the real set or the row has a single take."""
        from threadpoolctl import threadpool_limits

        real, *others = zip(self._sums, self._units, strict=True)
        several = [each.num_takes > 1 and self._sets[0].num_takes > 1 for each in self._sets[1:]]
        with threadpool_limits(1, "blas"):
            chosen = [other for other, enough in zip(others, several, strict=True) if enough]
            found = iter(resampled_fids(*real, chosen, self._resampling))
        return [next(found) if enough else () for enough in several]


def _features(
    samples: SampleSet,
    features: FeatureSet,
    protocol: Protocol,
    replication: int,
    side: int,
    among: Int64[np.ndarray, "chosen"] | None = None,
) -> _Described:
    places = place_clips(draw_clips(protocol, samples.fps, replication, side), samples, among)
    return _Described(describe_clips(samples, places, features), places.sequence)


def _split_takes(samples: SampleSet, rng: np.random.Generator) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Two random halves of the sequences, about equal in duration."""
    if samples.num_sequences < 2:
        raise ClipError(f"{samples.name}: {samples.num_sequences} take cannot be split into two halves")
    order = rng.permutation(samples.num_sequences)
    passed = np.cumsum(samples.sequences.num_frames[order])
    middle = int(np.clip(np.searchsorted(passed, passed[-1] / 2) + 1, 1, len(order) - 1))
    return order[:middle], order[middle:]


def _subset(samples: SampleSet, size: int, protocol: Protocol, replication: int) -> Int64[np.ndarray, "chosen"]:
    """Up to `size` random sequences that are long enough for the largest clips."""
    largest = int(protocol.sizes.sizes(samples.fps).max())
    long_enough = np.flatnonzero(samples.sequences.num_frames >= largest)
    rng = np.random.default_rng((protocol.seed, replication, 6))
    return rng.choice(long_enough, size=min(size, len(long_enough)), replace=False)


def _compare(
    real: Float64[np.ndarray, "clips features"],
    other: Float64[np.ndarray, "clips features"],
    protocol: Protocol,
    replication: int,
    manifold: RealManifold | None,
) -> dict[str, float]:
    """clip-FID, and with the real set's manifold all further metrics."""
    scores = {"clip_fid": frechet_distance(fit_gaussian(real), fit_gaussian(other))}
    if manifold is not None:
        rng = np.random.default_rng((protocol.seed, replication, 4))
        neighbours = manifold.compare(other)
        # FID∞ needs more than four clips per feature.
        with suppress(ValueError):
            scores["fid_infinity"] = fid_infinity(real, other, rng)
        scores["kid"] = kid(real, other)
        scores |= {"precision": neighbours.precision, "recall": neighbours.recall}
        scores |= {"density": neighbours.density, "coverage": neighbours.coverage}
    return scores


def _summarise(replications: list[dict[str, float]], resampled: Resampled = ()) -> Number:
    by_name = {key: [scores[key] for scores in replications if key in scores] for key in replications[0]}
    clip_fid = over_replications(by_name.pop("clip_fid"), resampled)
    return replace(clip_fid, details={name: over_replications(values).value for name, values in by_name.items()})


def _of_single_sets(found: Number, protocol: Protocol) -> Number:
    """With the interval of a single replication instead of the mean's: each had its own takes."""
    return replace(found, ci95=float(found.drawing * np.sqrt(protocol.replications)))
