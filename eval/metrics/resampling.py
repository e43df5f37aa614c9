"""Bootstrap over takes, not over their frames or clips.

A take's count in one resampling is Poisson(1), from a generator seeded by the take's name. A take thus has the same
count in every set that holds it, and differences between rows are paired. Motions of one take are not independent,
takes are (Field & Welsh 2007); Poisson counts replace multinomial ones (Chamandy et al. 2012, "Estimating uncertainty
for massive data streams").
"""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from eval.metrics.gaussian import Gaussian, quick_frechet_distance
from eval.metrics.number import Resampled
from motionkit.core.shapes import Float, Float64, Int64

Weights = Float64[np.ndarray, "resamplings units"]
Labels = Int64[np.ndarray, "labels"]

RESAMPLINGS = 200
GAUSSIANS_AT_ONCE = 16
MOST_PRODUCTS = 1 << 25
"""Maximum number of elements of all takes' products; beyond it, takes are resampled in blocks."""
FEWEST_BLOCKS, MOST_BLOCKS = 32, 1024


@dataclass(frozen=True)
class Resampling:
    """Number of resamplings, and their seed."""

    count: int = RESAMPLINGS
    seed: int = 0

    def weights(self, names: Sequence[str]) -> Weights:
        """Counts of the named takes in each resampling: the same numbers for a name in any set."""
        columns = [_appearances(name, self.count, self.seed) for name in names]
        return np.stack(columns, axis=1) if columns else np.zeros((self.count, 0))


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

    def weights(self, resampling: Resampling) -> Weights:
        """Count of each unit: its take's, times its generation's if there are several (Owen 2007)."""
        takes, place = np.unique(self.takes, return_inverse=True)
        weights = resampling.weights([f"take {name}" for name in takes.tolist()])[:, place]
        generations, place = np.unique(self.generations, return_inverse=True)
        if len(generations) > 1:
            weights = weights * resampling.weights([f"generation {name}" for name in generations.tolist()])[:, place]
        return weights


def units_of(takes: Sequence[str], generations: Sequence[int] = (), blocks: int | None = None) -> Units:
    """Units of motions by their takes; with `blocks`, takes are grouped into that many blocks by their names."""
    names = list(takes) if blocks is None else [_block(take, blocks) for take in takes]
    pairs = list(zip(names, map(str, generations) if generations else [""] * len(names), strict=True))
    place = {pair: index for index, pair in enumerate(dict.fromkeys(pairs))}
    unit = np.array([place[pair] for pair in pairs], dtype=np.int64)
    return Units(unit, tuple(take for take, _ in place), tuple(generation for _, generation in place))


def blocks_for(num_takes: int, num_features: int) -> int | None:
    """Number of blocks of takes whose products fit into memory; None if no blocks are needed."""
    most = int(np.clip(MOST_PRODUCTS // num_features**2, FEWEST_BLOCKS, MOST_BLOCKS))
    return most if num_takes > most else None


def _block(take: str, blocks: int) -> str:
    return str(int.from_bytes(hashlib.sha256(take.encode()).digest()[16:24], "little") % blocks)


class UnitSums:
    """Per unit: number of feature vectors, their sum and the sum of their outer products, about `centre`."""

    def __init__(self, num_units: int, centre: Float64[np.ndarray, "features"]) -> None:
        self.centre = centre
        self._count = np.zeros(num_units)
        self._sum = np.zeros((num_units, centre.size))
        self._products = np.zeros((num_units, centre.size, centre.size))

    def add(self, features: Float[np.ndarray, "samples features"], unit: Int64[np.ndarray, "samples"]) -> None:
        """Add feature vectors, each of one unit."""
        order = np.argsort(unit, kind="stable")
        found, starts = np.unique(unit[order], return_index=True)
        centred = features[order] - self.centre
        for index, rows in zip(found.tolist(), np.split(centred, starts[1:]), strict=True):
            self._count[index] += len(rows)
            self._sum[index] += rows.sum(axis=0)
            self._products[index] += rows.T @ rows

    def gaussians(self, weights: Weights) -> Iterator[Gaussian | None]:
        """The Gaussian of every resampling; None if fewer than two samples were drawn."""
        size = self.centre.size
        products = self._products.reshape(len(self._products), size * size)
        for first in range(0, len(weights), GAUSSIANS_AT_ONCE):
            part = weights[first : first + GAUSSIANS_AT_ONCE]
            counts, sums = part @ self._count, part @ self._sum
            for count, total, product in zip(counts.tolist(), sums, part @ products, strict=True):
                if count < 2:
                    yield None
                    continue
                mean = total / count
                scatter = product.reshape(size, size) - count * np.outer(mean, mean)
                yield Gaussian(self.centre + mean, scatter / (count - 1), round(count))


def weighted_means(
    values: Float[np.ndarray, "samples"], unit: Int64[np.ndarray, "samples"], weights: Weights
) -> Resampled:
    """The mean of values in every resampling of their units."""
    num_units = weights.shape[1]
    counts = weights @ np.bincount(unit, minlength=num_units)
    sums = weights @ np.bincount(unit, values, minlength=num_units)
    return tuple(total / count if count else None for total, count in zip(sums.tolist(), counts.tolist(), strict=True))


Score = Callable[[Gaussian, Gaussian], float]
"""A score of two sets of feature vectors, real and other, by their means and covariances."""


def resampled_scores(
    real: UnitSums, real_units: Units, others: Sequence[tuple[UnitSums, Units]], score: Score, resampling: Resampling
) -> list[Resampled]:
    """The score of every other set against the real one in every resampling of their takes."""
    sets = [each.gaussians(units.weights(resampling)) for each, units in ((real, real_units), *others)]
    rows: list[list[float | None]] = [[] for _ in others]
    for reference, *found in zip(*sets, strict=True):
        for values, gaussian in zip(rows, found, strict=True):
            values.append(None if reference is None or gaussian is None else score(reference, gaussian))
    return [tuple(values) for values in rows]


Features = Float[np.ndarray, "_samples features"]


def resampled_fid(
    real: Features, real_takes: Sequence[str], other: Features, other_units: Callable[[int | None], Units]
) -> Resampled:
    """FID in every resampling of the takes of both sets; `other_units` gives the other set's units by number of blocks.

    () if either set has a single take.
    """
    blocks = blocks_for(max(len(set(real_takes)), len(other)), real.shape[1])
    sides = []
    for features, units in ((real, units_of(real_takes, blocks=blocks)), (other, other_units(blocks))):
        if len(set(units.takes)) < 2:
            return ()
        sums = UnitSums(len(units.takes), real.mean(axis=0))
        sums.add(features, units.unit)
        sides.append((sums, units))
    return resampled_scores(*sides[0], sides[1:], quick_frechet_distance, Resampling())[0]


PAIRS = 4096


def resampled_mean_distance(
    features: Features, unit: Int64[np.ndarray, "samples"], weights: Weights, labels: Labels | None = None
) -> Resampled:
    """The mean distance of random pairs of different samples; with labels, of one class, classes weighted equally."""
    rng = np.random.default_rng(len(features))
    classes = [np.arange(len(features))] if labels is None else [np.flatnonzero(labels == each) for each in set(labels)]
    found = []
    for members in classes:
        if len(members) < 2:
            continue
        first = rng.integers(len(members), size=max(PAIRS // len(classes), 64))
        second = (first + rng.integers(1, len(members), size=len(first))) % len(members)
        a, b = members[first], members[second]
        distances = np.linalg.norm(features[a] - features[b], axis=1)
        together = weights[:, unit[a]] * weights[:, unit[b]]
        drawn = together.sum(axis=1)
        found.append((together @ distances) / np.where(drawn > 0, drawn, np.nan))
    if not found:
        return ()
    there = np.isfinite(found).sum(axis=0)
    totals = np.nansum(found, axis=0)
    return tuple(total / count if count else None for total, count in zip(totals.tolist(), there.tolist(), strict=True))
