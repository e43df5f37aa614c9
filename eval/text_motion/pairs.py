"""Embeddings of texts and their motions, and their scores in the bootstrap over takes."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from eval.metrics.number import (
    Resampled,
    Resampling,
    Units,
    resampled_fid,
    resampled_mean_distance,
    units_of,
    weighted_means,
)
from eval.metrics.retrieval import RANKS, hits
from motionkit.core.shapes import Float, Float64, Int64

Pairs = Float[np.ndarray, "_pairs _numbers"]
Distances = Float64[np.ndarray, "_pools _pool _pool"]
AddTerms = Callable[[Distances, Int64[np.ndarray, "_chosen"]], None]
"""Consumes pools' distances (texts as rows, motions as columns) and the rows of the pairs in the pools."""


@dataclass(frozen=True, eq=False)
class TextMotionPairs:
    """Embeddings of texts and of the motions that belong to them, row by row, in one space.

    `takes` name the real take of each pair, which intervals resample; without them each row is a take of its own.
    Raises `ValueError` for unequal numbers or widths, or no pairs.
    """

    texts: Float[np.ndarray, "texts numbers"]
    motions: Float[np.ndarray, "motions features"]
    takes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.texts.shape != self.motions.shape or not len(self.texts):
            raise ValueError(
                f"embeddings of texts are {self.texts.shape}, of motions {self.motions.shape}: "
                "one of either for each pair"
            )
        if len(self.takes) not in (0, len(self.texts)):
            raise ValueError(f"{len(self.takes)} takes for {len(self.texts)} pairs")

    def select(self, rows: Int64[np.ndarray, "chosen"]) -> "TextMotionPairs":
        """Some of the pairs, in the order of `rows`."""
        takes = tuple(self.takes[row] for row in rows.tolist()) if self.takes else ()
        return TextMotionPairs(self.texts[rows], self.motions[rows], takes)

    @property
    def take_names(self) -> tuple[str, ...]:
        """The take of each pair; by default its row's index."""
        return self.takes or tuple(map(str, range(len(self.motions))))


class PairTerms:
    """Per-pair terms of one row's metrics over all replications, and the take of each pair."""

    def __init__(self, draws: Sequence[TextMotionPairs]) -> None:
        self._draws = draws
        self._first = np.cumsum([0, *(len(draw.motions) for draw in draws)]).tolist()
        self._values: dict[str, list[Float64[np.ndarray, _queries]]] = defaultdict(list)
        self._rows: list[Int64[np.ndarray, _queries]] = []

    def of_draw(self, which: int) -> AddTerms:
        """A function that adds the pools of one draw."""
        return partial(self._add, self._first[which])

    def _add(self, first: int, distances: Distances, order: Int64[np.ndarray, "_chosen"]) -> None:
        pools, pool, _ = distances.shape
        self._rows.append(first + order[: pools * pool])
        for suffix, directed in (("", distances), ("_motion_asks", distances.swapaxes(1, 2))):
            for rank, found in enumerate(hits(directed, RANKS), start=1):
                self._values[f"r_precision_top{rank}{suffix}"].append(found.ravel())
        self._values["mm_dist"].append(np.diagonal(distances, axis1=1, axis2=2).ravel())

    def resampled(self, real: TextMotionPairs) -> dict[str, Resampled]:
        """Every metric's values in the bootstrap over takes; none if there is a single take."""
        units = self._units(None)
        if len(set(units.takes)) < 2:
            return {}
        motions = np.concatenate([draw.motions for draw in self._draws]).astype(np.float64)
        return self.resampled_means() | {
            "fid": resampled_fid(real.motions.astype(np.float64), real.take_names, motions, self._units),
            "diversity": resampled_mean_distance(motions, units.unit, units.weights(Resampling())),
        }

    def resampled_means(self) -> dict[str, Resampled]:
        """R-Precision and MM-Dist in the bootstrap."""
        units = self._units(None)
        unit, weights = units.unit[np.concatenate(self._rows)], units.weights(Resampling())
        return {name: weighted_means(np.concatenate(values), unit, weights) for name, values in self._values.items()}

    def resampled_mean(self, metric: Callable[[Pairs, Pairs], float]) -> Resampled:
        """A mean over pairs in the bootstrap."""
        values = [
            metric(text[None], motion[None])
            for draw in self._draws
            for text, motion in zip(draw.texts, draw.motions, strict=True)
        ]
        units = self._units(None)
        return weighted_means(np.array(values), units.unit, units.weights(Resampling()))

    def _units(self, blocks: int | None) -> Units:
        takes = [take for draw in self._draws for take in draw.take_names]
        draws = [number for number, draw in enumerate(self._draws) for _ in draw.take_names]
        return units_of(takes, draws if len(self._draws) > 1 else (), blocks)


def resampled_multimodality(
    repeated: Float[np.ndarray, "texts generations features"] | None, name: str
) -> dict[str, Resampled]:
    """MultiModality, by name, in a bootstrap over texts; none for a single text or a single motion of each."""
    if repeated is None or min(repeated.shape[:2]) < 2:
        return {}
    distances = np.linalg.norm(repeated - np.roll(repeated, 1, axis=1), axis=-1).mean(axis=1)
    weights = Resampling().weights([f"text {number}" for number in range(len(repeated))])
    return {name: weighted_means(distances, np.arange(len(repeated)), weights)}
