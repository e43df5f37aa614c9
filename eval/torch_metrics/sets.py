"""Metrics of whole sets of embeddings: the states are sums about the mean, or the rows themselves."""

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torchmetrics import Metric

from eval.metrics.actions import NUM_PAIRS, PAIRS, diversity, multimodality
from eval.metrics.gaussian import FeatureSums, feature_sums, frechet_distance
from eval.metrics.retrieval import REFERENCE_POOL, r_precision
from eval.torch_metrics.arrays import array_of, rows_of
from motionkit.core.shapes import Float


class FID(Metric):
    """Fréchet distance of two sets of features, as `eval.metrics.gaussian.fid`: `update(features, real=True | False)`.

    Features of any network: [samples, features]. The states are number, mean and scatter of the samples, so memory is
    constant; those of other batches and processes are merged about their means in float64, which is accurate far from
    zero.

    >>> metric = FID()
    >>> features = torch.randn(100, 4, generator=torch.Generator().manual_seed(0))
    >>> metric.update(features, real=True)
    >>> metric.update(features + 2, real=False)
    >>> round(float(metric.compute()), 4)  # four features, each moved by 2
    16.0
    """

    full_state_update = False
    is_differentiable = False
    higher_is_better = False
    real: list[Tensor]
    generated: list[Tensor]

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.add_state("real", [], dist_reduce_fx="cat")
        self.add_state("generated", [], dist_reduce_fx="cat")

    def update(self, features: Float[Tensor, "samples features"], real: bool) -> None:
        """Add a batch to one side. Raises `ValueError` for none, NaN or infinity, or another number of features."""
        added = feature_sums(array_of(features).astype(np.float64))
        state = self.real if real else self.generated
        state[:] = [_packed(_merged(state).merged(added)).to(self.device)]

    def compute(self) -> Float[Tensor, ""]:
        """The distance, float64. Raises `ValueError` if a side has fewer than 2 samples."""
        distance = frechet_distance(_merged(self.real).gaussian, _merged(self.generated).gaussian)
        return torch.tensor(distance, dtype=torch.float64, device=self.device)


def _packed(sums: FeatureSums) -> Float[Tensor, "1 size size"]:
    """The sums as one matrix: the number in a corner, the mean beside it, the scatter inside."""
    assert sums.mean is not None and sums.scatter is not None
    packed = np.zeros((1, sums.mean.size + 1, sums.mean.size + 1))
    packed[0, 0, 0], packed[0, 0, 1:], packed[0, 1:, 1:] = sums.num_samples, sums.mean, sums.scatter
    return torch.from_numpy(packed)


def _merged(state: list[Tensor] | Tensor) -> FeatureSums:
    total = FeatureSums()
    for row in rows_of(state, "samples") if len(state) else ():
        total = total.merged(FeatureSums(int(row[0, 0]), row[0, 1:], row[1:, 1:]))
    return total


class RPrecision(Metric):
    """R-Precision and MM-Dist of pairs, as `eval.metrics.retrieval.r_precision`: `update(queries, candidates)`.

    `queries` are embeddings of texts and `candidates` of their motions (the reference protocol), or the other way
    round, [pairs, numbers] each. Pools are drawn in `compute`, from a seed, so they do not depend on the batches.

    >>> metric = RPrecision(pool=4)
    >>> texts = 10 * torch.eye(8)
    >>> metric.update(texts, texts + 1)
    >>> {name: round(float(value), 4) for name, value in metric.compute().items()}
    {'r_precision_top1': 1.0, 'r_precision_top2': 1.0, 'r_precision_top3': 1.0, 'mm_dist': 2.8284}
    """

    full_state_update = False
    is_differentiable = False
    queries: list[Tensor]
    candidates: list[Tensor]

    def __init__(self, pool: int = REFERENCE_POOL, seed: int = 0, **settings: Any) -> None:
        super().__init__(**settings)
        self.pool, self.seed = pool, seed
        self.add_state("queries", [], dist_reduce_fx="cat")
        self.add_state("candidates", [], dist_reduce_fx="cat")

    def update(self, queries: Float[Tensor, "pairs numbers"], candidates: Float[Tensor, "pairs numbers"]) -> None:
        """Add pairs. Raises `ValueError` for unequal shapes."""
        if queries.shape != candidates.shape:
            raise ValueError(f"queries are {tuple(queries.shape)}, candidates {tuple(candidates.shape)}")
        self.queries.append(queries.detach().double())
        self.candidates.append(candidates.detach().double())

    def compute(self) -> dict[str, Float[Tensor, ""]]:
        """`r_precision_top1` … `3` and `mm_dist`, float64. Raises `ValueError` for fewer pairs than a pool."""
        queries, candidates = rows_of(self.queries, "pairs"), rows_of(self.candidates, "pairs")
        found = r_precision(queries, candidates, rng=np.random.default_rng(self.seed), pool=self.pool)
        values = {f"r_precision_top{rank}": share for rank, share in enumerate(found.top.tolist(), start=1)}
        values["mm_dist"] = found.matching_distance
        return {name: torch.tensor(value, dtype=torch.float64, device=self.device) for name, value in values.items()}


class _Rows(Metric):
    """A set of embeddings, and the number of random pairs compared."""

    full_state_update = False
    is_differentiable = False
    rows: list[Tensor]

    def __init__(self, num_pairs: int, seed: int, **settings: Any) -> None:
        super().__init__(**settings)
        self.num_pairs, self.seed = num_pairs, seed
        self.add_state("rows", [], dist_reduce_fx="cat")

    def _all(self, what: str) -> tuple[np.ndarray, np.random.Generator]:
        return rows_of(self.rows, what), np.random.default_rng(self.seed)

    def _value(self, value: float) -> Float[Tensor, ""]:
        return torch.tensor(value, dtype=torch.float64, device=self.device)


class Diversity(_Rows):
    """Mean distance of 300 random pairs, as `eval.metrics.actions.diversity`: `update(features [samples, features])`.

    The best value is the real set's own.

    >>> metric = Diversity()
    >>> metric.update(torch.ones(10, 4))
    >>> float(metric.compute())
    0.0
    """

    def __init__(self, num_pairs: int = PAIRS, seed: int = 0, **settings: Any) -> None:
        super().__init__(num_pairs, seed, **settings)

    def update(self, features: Float[Tensor, "samples features"]) -> None:
        """Add samples."""
        self.rows.append(features.detach().double())

    def compute(self) -> Float[Tensor, ""]:
        """The mean distance, float64. Raises `ValueError` for fewer than two samples."""
        features, rng = self._all("samples")
        return self._value(diversity(features, rng, self.num_pairs))


class MultiModality(_Rows):
    """Mean distance of motions of one text, as `eval.metrics.actions.multimodality` (NeRM Eq. 8).

    `update(features [texts, generations, features])`; all texts have the same number of generations, at least 2 ·
    `num_pairs`. The best value is the real set's own.

    >>> metric = MultiModality(num_pairs=2)
    >>> metric.update(torch.zeros(3, 4, 8))
    >>> float(metric.compute())
    0.0
    """

    def __init__(self, num_pairs: int = NUM_PAIRS, seed: int = 0, **settings: Any) -> None:
        super().__init__(num_pairs, seed, **settings)

    def update(self, features: Float[Tensor, "texts generations features"]) -> None:
        """Add texts with all their generations."""
        self.rows.append(features.detach().double())

    def compute(self) -> Float[Tensor, ""]:
        """The mean distance, float64. Raises `ValueError` if a text has too few generations."""
        features, rng = self._all("texts")
        return self._value(multimodality(features, rng=rng, num_pairs=self.num_pairs))
