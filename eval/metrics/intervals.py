"""One number of a table and its interval: over a protocol's replications, and in the bootstrap over takes.

A take's count in one resampling is Poisson(1), from a generator seeded by the take's name. A take thus has the same
count in every set that holds it, and differences between rows are paired. Motions of one take are not independent,
takes are (Field & Welsh 2007); Poisson counts replace multinomial ones (Chamandy et al. 2012).
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import chain
from typing import Literal

import numpy as np

from eval.metrics.distributions import factors_of, frechet_distances
from motionkit.core.shapes import Float, Float64, Int64

Resampled = tuple[float | None, ...]
"""A number in every resampling of the takes; None if a resampling drew none of its samples."""

NORMAL_95 = 1.96
Verdict = Literal["lower", "higher", "not told apart"]


def half_width(resampled: Resampled) -> float | None:
    """1.96 standard deviations of a number's resamplings; None if no two of them differ.

    Not the quantiles: distances of distributions are larger for the fewer distinct takes of a resampling, so its
    quantiles lie above the number itself (docs/deviations.md has the coverage).
    """
    values = [value for value in resampled if value is not None]
    return float(NORMAL_95 * np.std(values, ddof=1)) if len(set(values)) > 1 else None


@dataclass(frozen=True)
class Number:
    """A number; `ci95` is half the width of its 95 % interval, 0 if there is none.

    `resampled` are its values in the bootstrap over takes; () without one. `drawing` is the half-width over the
    replications of a protocol alone, `details` are further numbers by name.
    """

    value: float
    ci95: float = 0.0
    resampled: Resampled = ()
    drawing: float = 0.0
    details: Mapping[str, float] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.value:.4g} ± {self.ci95:.2g}"

    def less(self, other: "Number") -> "Number | None":
        """This number minus another, with the interval of the same resampled takes; None if either has none."""
        if len(self.resampled) != len(other.resampled):
            return None
        pairs = zip(self.resampled, other.resampled, strict=True)
        width = half_width(tuple(None if a is None or b is None else a - b for a, b in pairs))
        return None if width is None else Number(self.value - other.value, width)

    @property
    def verdict(self) -> Verdict:
        """Of a difference: whether the interval excludes 0, and on which side it lies."""
        if abs(self.value) <= self.ci95:
            return "not told apart"
        return "lower" if self.value < 0 else "higher"


def over_replications(values: Sequence[float], resampled: Resampled = ()) -> Number:
    """Mean over R replications ± 1.96·std(ddof 0)/√R (text-to-motion final_evaluations.py).

    With resampled takes the interval is over both.
    """
    array = np.asarray(values, dtype=np.float64)
    drawing, width = float(NORMAL_95 * array.std() / np.sqrt(array.size)), half_width(resampled)
    return Number(
        float(array.mean()), drawing if width is None else float(np.hypot(width, drawing)), resampled, drawing
    )


def with_takes(value: float, resampled: Resampled) -> Number:
    """A number with its interval over takes."""
    return Number(value, half_width(resampled) or 0.0, resampled)


@dataclass
class Scores:
    """Metrics of a set of motions by their names in `eval.metrics.metric`, collected over a protocol's replications.

    `sizes` are the numbers of samples; `remarks` state where the data has less than the protocol requires.
    """

    replications: dict[str, list[float]] = field(default_factory=dict)
    resampled: dict[str, Resampled] = field(default_factory=dict)
    sizes: dict[str, int] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)

    def add(self, name: str, value: float) -> None:
        """Add a replication of a metric."""
        self.replications.setdefault(name, []).append(value)

    def remark(self, text: str) -> None:
        """Add a remark, once."""
        if text not in self.remarks:
            self.remarks.append(text)

    def remark_on_draws(self, draws: int, replications: int) -> None:
        """Add a remark on the interval if there are fewer sets of motions than replications."""
        if draws < replications:
            sets = "there is one set" if draws == 1 else f"there are {draws} sets"
            self.remark(f"{sets} of motions for {replications} replications: others would differ by more (--draws)")

    @property
    def values(self) -> dict[str, Number]:
        """Every metric's number."""
        return {
            name: over_replications(values, self.resampled.get(name, ())) for name, values in self.replications.items()
        }


Weights = Float64[np.ndarray, "resamplings units"]
Counts = Float64[np.ndarray, "resamplings"] | Int64[np.ndarray, "resamplings"]
Means = Float64[np.ndarray, "resamplings features"]
Covariances = Float64[np.ndarray, "resamplings features features"]
Labels = Int64[np.ndarray, "labels"]

RESAMPLINGS = 200
GAUSSIANS_AT_ONCE = 16
MOST_PRODUCTS = 1 << 25
"""Maximum number of elements of all takes' products; beyond it, takes are resampled in blocks."""
FEWEST_BLOCKS, MOST_BLOCKS = 32, 1024


def resampling_weights(names: Sequence[str], count: int = RESAMPLINGS, seed: int = 0) -> Weights:
    """Counts of the named takes in each resampling: the same numbers for a name in any set."""
    return np.stack([_appearances(name, count, seed) for name in names], axis=1)


@lru_cache(maxsize=1 << 14)
def _appearances(name: str, count: int, seed: int) -> Float64[np.ndarray, "resamplings"]:
    words = np.frombuffer(hashlib.sha256(name.encode()).digest()[:16], dtype="<u4").tolist()
    return np.random.default_rng((seed, *words)).poisson(1.0, size=count).astype(np.float64)


@dataclass(frozen=True, eq=False)
class Units:
    """Resampling units: the take of every motion, and its generation if there are several.

    `unit` [motions] counts units from 0, each a take (or a block of takes) in one generation; `takes` and `generations`
    [units] name both.
    """

    unit: Int64[np.ndarray, "motions"]
    takes: tuple[str, ...]
    generations: tuple[str, ...]

    def weights(self, count: int = RESAMPLINGS, seed: int = 0) -> Weights:
        """Counts of each unit: its take's, times its generation's if there are several (Owen 2007)."""
        takes, place = np.unique(self.takes, return_inverse=True)
        weights = resampling_weights([f"take {name}" for name in takes.tolist()], count, seed)[:, place]
        generations, place = np.unique(self.generations, return_inverse=True)
        if len(generations) > 1:
            names = [f"generation {name}" for name in generations.tolist()]
            weights = weights * resampling_weights(names, count, seed)[:, place]
        return weights


def units_of(takes: Sequence[str], generations: Sequence[int] = (), blocks: int | None = None) -> Units:
    """Units of motions by their takes; with `blocks`, takes are grouped into that many blocks by their names."""

    def name_of(take: str) -> str:
        digest = hashlib.sha256(take.encode()).digest()
        return take if blocks is None else str(int.from_bytes(digest[16:24], "little") % blocks)

    pairs = list(zip(map(name_of, takes), map(str, generations) if generations else [""] * len(takes), strict=True))
    place = {pair: index for index, pair in enumerate(dict.fromkeys(pairs))}
    unit = np.array([place[pair] for pair in pairs], dtype=np.int64)
    return Units(unit, tuple(take for take, _ in place), tuple(generation for _, generation in place))


def blocks_for(num_takes: int, num_features: int) -> int | None:
    """Number of blocks of takes whose products fit into memory; None if no blocks are needed."""
    most = int(np.clip(MOST_PRODUCTS // num_features**2, FEWEST_BLOCKS, MOST_BLOCKS))
    return most if num_takes > most else None


def units_of_draws(takes: Sequence[Sequence[str]], blocks: int | None = None) -> Units:
    """Units of the motions of several draws, each of which names the takes of its motions."""
    draws = [draw for draw, names in enumerate(takes) for _ in names]
    return units_of(list(chain.from_iterable(takes)), draws if len(takes) > 1 else (), blocks)


class UnitSums:
    """Per unit: number of feature vectors, their sum and the sum of their outer products, about `centre`."""

    def __init__(self, units: Units, centre: Float64[np.ndarray, "features"]) -> None:
        self.units, self.centre, num_units = units, centre, len(units.takes)
        self._count = np.zeros(num_units)
        self._sum = np.zeros((num_units, centre.size))
        self._products = np.zeros((num_units, centre.size, centre.size))

    def add(self, features: Float[np.ndarray, "samples features"], motion: Int64[np.ndarray, "samples"]) -> None:
        """Add feature vectors, each of one of the motions."""
        unit = self.units.unit[motion]
        order = np.argsort(unit, kind="stable")
        present, starts = np.unique(unit[order], return_index=True)
        centred = features[order] - self.centre
        for index, rows in zip(present.tolist(), np.split(centred, starts[1:]), strict=True):
            self._count[index] += len(rows)
            self._sum[index] += rows.sum(axis=0)
            self._products[index] += rows.T @ rows

    def gaussians(self, weights: Weights) -> tuple[Counts, Means, Covariances]:
        """Number of samples, mean and N − 1 covariance of each resampling; meaningless for fewer than two samples."""
        counts, size = weights @ self._count, self.centre.size
        means = (weights @ self._sum) / np.maximum(counts, 1.0)[:, None]
        scatter = (weights @ self._products.reshape(-1, size * size)).reshape(-1, size, size)
        scatter -= counts[:, None, None] * means[:, :, None] * means[:, None, :]
        return counts, self.centre + means, scatter / np.maximum(counts - 1.0, 1.0)[:, None, None]


def weighted_means(
    values: Float[np.ndarray, "samples"], unit: Int64[np.ndarray, "samples"], weights: Weights
) -> Resampled:
    """The mean of values in every resampling of their units."""
    num_units = weights.shape[1]
    counts = weights @ np.bincount(unit, minlength=num_units)
    sums = weights @ np.bincount(unit, values, minlength=num_units)
    return quotients(sums, counts)


def quotients(totals: Counts, counts: Counts) -> Resampled:
    """Totals divided by counts; None where the count is 0."""
    pairs = zip(totals.tolist(), counts.tolist(), strict=True)
    return tuple(total / count if count else None for total, count in pairs)


def resampled_fids(
    real: UnitSums, others: Sequence[UnitSums], count: int = RESAMPLINGS, seed: int = 0
) -> list[Resampled]:
    """FID of every other set against the real one in every resampling of their takes."""
    weights = [sums.units.weights(count, seed) for sums in (real, *others)]
    rows: list[list[float | None]] = [[] for _ in others]
    for first in range(0, count, GAUSSIANS_AT_ONCE):
        real_weights, *other_weights = (each[first : first + GAUSSIANS_AT_ONCE] for each in weights)
        real_counts, real_means, real_covariances = real.gaussians(real_weights)
        factors = factors_of(real_covariances)
        for values, sums, own in zip(rows, others, other_weights, strict=True):
            counts, means, covariances = sums.gaussians(own)
            fids = frechet_distances(real_means, factors, means, covariances).tolist()
            are_known = np.minimum(counts, real_counts) >= 2
            values += [fid if known else None for fid, known in zip(fids, are_known, strict=True)]
    return [tuple(values) for values in rows]


Features = Float[np.ndarray, "_samples features"]


def resampled_fid(
    real: Features, real_takes: Sequence[str], other: Features, other_takes: Sequence[Sequence[str]]
) -> Resampled:
    """FID in every resampling of the takes of both sets, the other one's by draw; () if either has a single take."""
    blocks = blocks_for(max(len(set(real_takes)), len(other)), real.shape[1])
    sides = []
    for features, takes in ((real, [real_takes]), (other, other_takes)):
        units = units_of_draws(takes, blocks)
        if len(set(units.takes)) < 2:
            return ()
        sides.append(UnitSums(units, real.mean(axis=0)))
        sides[-1].add(features, np.arange(len(features)))
    return resampled_fids(sides[0], sides[1:])[0]


PAIRS = 4096


def resampled_mean_distance(
    features: Features, unit: Int64[np.ndarray, "samples"], weights: Weights, labels: Labels | None = None
) -> Resampled:
    """The mean distance of random pairs of different samples; with labels, of one class, classes weighted equally."""
    rng = np.random.default_rng(len(features))
    classes = [np.arange(len(features))] if labels is None else [np.flatnonzero(labels == each) for each in set(labels)]
    means = []
    for members in classes:
        if len(members) < 2:
            continue
        first = rng.integers(len(members), size=max(PAIRS // len(classes), 64))
        second = (first + rng.integers(1, len(members), size=len(first))) % len(members)
        a, b = members[first], members[second]
        distances = np.linalg.norm(features[a] - features[b], axis=1)
        together = weights[:, unit[a]] * weights[:, unit[b]]
        drawn = together.sum(axis=1)
        means.append((together @ distances) / np.where(drawn > 0, drawn, np.nan))
    return quotients(np.nansum(means, axis=0), np.isfinite(means).sum(axis=0)) if means else ()
