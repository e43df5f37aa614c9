"""The project's metrics as `torchmetrics.Metric`s: update, compute, reset, on any device, over batches and processes.

Each accumulates the inputs of a pure function of `eval.metrics` and calls it in `compute`, so the value does not depend
on the batches. They need the extra `metrics`; the functions do not.
"""

from collections.abc import Mapping, Sequence
from functools import cached_property
from importlib.util import find_spec
from inspect import signature
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from eval.clip_fid.score import KINEMATIC, Comparison, Motions, Protocol, samples_of
from eval.metrics.registry import find_metric
from eval.metrics.retrieval import REFERENCE_POOL, r_precision
from motionkit.core.errors import MissingExtraError
from motionkit.core.shapes import Float, Int
from motionkit.core.timegrid import Framerate, parse_fps

if find_spec("torchmetrics") is None:
    raise MissingExtraError("torchmetrics", "metrics")
from torchmetrics import Metric
from torchmetrics.utilities import dim_zero_cat


def array_of(values: Tensor | npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Values as an array; floats become float64, since numpy lacks bfloat16."""
    if isinstance(values, Tensor):
        values = values.detach().cpu()
        return np.asarray(values.double() if values.is_floating_point() else values)
    return np.asarray(values)


def scalars(metric: "Metric", values: Mapping[str, float]) -> dict[str, Float[Tensor, ""]]:
    """Values as float64 tensors on a metric's device."""
    return {name: torch.tensor(value, dtype=torch.float64, device=metric.device) for name, value in values.items()}


class DeclaredMean(Metric):
    """A metric of `eval.metrics` that is a mean, by its name there, over batches and processes.

    `update` takes the function's arrays by position; settings, such as `fps`, are passed here. Other keywords are
    torchmetrics' own. A batch is weighted by the number of elements that its value is a mean over, so the result does
    not depend on the batches. Raises `KeyError` for a name that is not declared; `update` raises `ValueError` for a
    metric that is not a mean.

    >>> metric = DeclaredMean("velocity_error", fps=60)
    >>> metric.update(torch.zeros(2, 30, 22, 3), torch.zeros(2, 30, 22, 3))
    >>> metric.compute()
    tensor(0., dtype=torch.float64)
    """

    full_state_update = False
    total: Tensor
    weight: Tensor

    def __init__(self, declared: str, **settings: Any) -> None:
        metric = find_metric(declared)
        own = {name: settings.pop(name) for name in signature(metric.function).parameters if name in settings}
        if "fps" in own:
            own["fps"] = float(own["fps"])
        super().__init__(**settings)
        self.metric_name, self.settings = metric.name, own
        self.add_state("total", torch.zeros((), dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("weight", torch.zeros((), dtype=torch.float64), dist_reduce_fx="sum")

    @property
    def higher_is_better(self) -> bool | None:  # type: ignore[override]
        """As the metric is declared."""
        return find_metric(self.metric_name).higher_is_better

    def update(self, *arrays: Tensor | npt.NDArray[Any]) -> None:
        """Add a batch. Raises as the function."""
        total, weight = find_metric(self.metric_name).weighted(*map(array_of, arrays), **self.settings)
        self.total += total
        self.weight += weight

    def compute(self) -> Tensor:
        """The mean over all batches, float64. Raises `ValueError` if there are none."""
        if not self.weight:
            raise ValueError("there is nothing to average: call update first")
        return (self.total / self.weight) ** (1 / find_metric(self.metric_name).exponent)


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
    queries: list[Tensor]
    candidates: list[Tensor]

    def __init__(self, pool: int = REFERENCE_POOL, seed: int = 0, **settings: Any) -> None:
        super().__init__(**settings)
        self.pool, self.seed = pool, seed
        self.add_state("queries", [], dist_reduce_fx="cat")
        self.add_state("candidates", [], dist_reduce_fx="cat")

    def update(self, queries: Float[Tensor, "pairs numbers"], candidates: Float[Tensor, "pairs numbers"]) -> None:
        """Add pairs."""
        self.queries.append(queries.detach().double())
        self.candidates.append(candidates.detach().double())

    def compute(self) -> dict[str, Float[Tensor, ""]]:
        """`r_precision_top1` … `3` and `mm_dist`, float64. Raises `ValueError` for fewer pairs than a pool."""
        rng = np.random.default_rng(self.seed)
        top, mm_dist = r_precision(
            array_of(dim_zero_cat(self.queries)), array_of(dim_zero_cat(self.candidates)), rng=rng, pool=self.pool
        )
        shares = {f"r_precision_top{rank}": share for rank, share in enumerate(top.tolist(), start=1)}
        return scalars(self, {**shares, "mm_dist": mm_dist})


class ClipFID(Metric):
    """clip-FID of generated motions against real ones at one framerate, as `eval.clip_fid` computes it.

    `real` are the reference motions, and `train` those that the descriptor is fitted on (by default the real ones):
    `Motion`s of `fps`, or arrays [frames, 22, 3] in metres, y up. `update` takes motions of any lengths and keeps them,
    since clips are drawn in proportion to the duration of all of them. The value is that of `eval.clip_fid` on the same
    motions in the same order. Scores are comparable only for the same real motions, framerate and number of clips.

    >>> rng = np.random.default_rng(0)
    >>> walks = [rng.normal(size=(90, 22, 3)).cumsum(axis=0) / 100 for _ in range(4)]
    >>> metric = ClipFID(fps=60, real=walks, clips=128, replications=2)
    >>> metric.update([torch.from_numpy(walk) for walk in walks[:2]])
    >>> metric.update(torch.zeros(2, 90, 22, 3), num_frames=torch.tensor([90, 64]))
    >>> sorted(metric.compute())
    ['clip_fid', 'clip_fid_ci95']
    """

    full_state_update = False
    higher_is_better = False
    positions: list[Tensor]
    num_frames: list[Tensor]

    def __init__(
        self,
        fps: Framerate,
        real: Motions,
        *,
        train: Motions | None = None,
        clips: int = 4096,
        replications: int = 20,
        seed: int = 0,
        **settings: Any,
    ) -> None:
        super().__init__(**settings)
        self.fps = parse_fps(fps)
        self._real = samples_of("real", real, self.fps)
        self._train = self._real if train is None else samples_of("train", train, self.fps)
        self._protocol = Protocol(num_clips=clips, replications=replications, detailed_replications=0, seed=seed)
        self.add_state("positions", [], dist_reduce_fx="cat")
        self.add_state("num_frames", [], dist_reduce_fx="cat")

    def update(
        self,
        motions: Sequence[Float[Tensor, "_frames 22 3"]] | Float[Tensor, "motions frames 22 3"],
        num_frames: Int[Tensor, "motions"] | None = None,
    ) -> None:
        """Add motions [frames, 22, 3] of any lengths, or a padded batch with each motion's `num_frames`.

        Raises `UsageError` for other shapes, and `ValueError` for lengths beyond the batch or NaN.
        """
        lengths = [len(motion) for motion in motions] if num_frames is None else num_frames.tolist()
        own = [array_of(motion)[:length] for motion, length in zip(motions, lengths, strict=True)]
        samples = samples_of("generated", own, self.fps)
        if samples.sequences.num_frames.tolist() != lengths:
            raise ValueError(f"num_frames {lengths} exceed a batch of {max(map(len, motions))} frames")
        self.positions.append(torch.from_numpy(samples.sequences.values).to(self.device))
        self.num_frames.append(torch.tensor(lengths, device=self.device))

    def compute(self) -> dict[str, Float[Tensor, ""]]:
        """`clip_fid` and half the width of its 95 % interval, `clip_fid_ci95`, float64."""
        ends = np.cumsum(array_of(dim_zero_cat(self.num_frames)))
        samples = samples_of("generated", np.split(array_of(dim_zero_cat(self.positions)), ends[:-1]), self.fps)
        score = self._comparison.scores({"generated": samples})["generated"]
        return scalars(self, {"clip_fid": score.value, "clip_fid_ci95": score.ci95})

    @cached_property
    def _comparison(self) -> Comparison:
        return KINEMATIC.comparison(self._real, self._train, self._protocol)
