"""Metrics that are means: their states are two sums, Σ weight·value and Σ weight."""

from collections.abc import Sequence
from inspect import signature
from typing import Any, ClassVar

import numpy.typing as npt
import torch
from torch import Tensor
from torchmetrics import Metric

from eval.metrics.metric import MeanSums, find_metric
from eval.metrics.physical import ground_height
from eval.torch_metrics.arrays import array_of
from motionkit.core.shapes import Float
from motionkit.core.timegrid import Framerate, parse_fps


class DeclaredMean(Metric):
    """A metric of `eval.metrics` that is a mean, by its name there, over batches and processes.

    `update` takes the function's arrays by position; settings, such as `fps`, are passed here. Other keywords are
    torchmetrics' own. A batch is weighted by the number of elements that its value is a mean over, so the result does
    not depend on the batches. Raises `KeyError` for a name that is not declared and `ValueError` for a metric that is
    not a mean.

    >>> metric = DeclaredMean("velocity_error", fps=60)
    >>> metric.update(torch.zeros(2, 30, 22, 3), torch.zeros(2, 30, 22, 3))
    >>> metric.compute()
    tensor(0., dtype=torch.float64)
    """

    full_state_update = False
    is_differentiable = False
    declared: ClassVar[str] = ""
    total: Tensor
    weight: Tensor

    def __init__(self, declared: str = "", **settings: Any) -> None:
        metric = find_metric(declared or self.declared)
        if metric.weight is None:
            raise ValueError(f"{metric.name} is not a mean over batches: its function needs all samples")
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
        metric, given = find_metric(self.metric_name), [array_of(each) for each in arrays]
        assert metric.weight is not None
        value = metric.function(*given, **self.settings)
        assert isinstance(value, float)
        batch = MeanSums().added(value**metric.exponent, metric.weight(*given))
        self.total += batch.total
        self.weight += batch.weight

    def compute(self) -> Tensor:
        """The mean over all batches, float64. Raises `ValueError` if there are none."""
        mean = MeanSums(float(self.total), float(self.weight)).mean
        exponent = 1 / find_metric(self.metric_name).exponent
        return torch.tensor(mean**exponent, dtype=torch.float64, device=self.total.device)


class Accuracy(DeclaredMean):
    """Share of samples whose own class scores highest: `update(scores [samples, classes], labels [samples])`.

    >>> metric = Accuracy()
    >>> metric.update(torch.tensor([[0.9, 0.1], [0.6, 0.4]]), torch.tensor([0, 1]))
    >>> float(metric.compute())
    0.5
    """

    declared = "accuracy"


class MPJPE(DeclaredMean):
    """Mean distance of joints with the roots aligned, metres: `update(predicted [frames, joints, 3], target)`.

    >>> metric = MPJPE()
    >>> metric.update(torch.zeros(30, 22, 3), torch.ones(30, 22, 3))  # the path does not count
    >>> float(metric.compute())
    0.0
    """

    declared = "mpjpe"


class AccelerationError(DeclaredMean):
    """Mean distance of joints' accelerations, m/s²: `update(predicted [clips, frames, joints, 3], target)`.

    >>> metric = AccelerationError(fps=60)
    >>> metric.update(torch.zeros(2, 30, 22, 3), torch.zeros(2, 30, 22, 3))
    >>> float(metric.compute())
    0.0
    """

    declared = "acceleration_error"


class JerkError(DeclaredMean):
    """Mean distance of joints' jerks, m/s³: `update(predicted [clips, frames, joints, 3], target)`.

    >>> metric = JerkError(fps=60)
    >>> metric.update(torch.zeros(2, 30, 22, 3), torch.zeros(2, 30, 22, 3))
    >>> float(metric.compute())
    0.0
    """

    declared = "jerk_error"


class SkatingSpeed(DeclaredMean):
    """Foot skating, m/s, of one sequence per update: `update(feet [frames, 4, 3])`, ankle and toe of either foot.

    >>> metric = SkatingSpeed(fps=60, floor=0.0)
    >>> metric.update(torch.zeros(30, 4, 3))
    >>> float(metric.compute())
    0.0
    """

    declared = "skating_speed"


class L2P(DeclaredMean):
    """L2P of in-betweening: `update(predicted [clips, frames, joints, 3], target)`; `std` [joints, 3] of training.

    >>> metric = L2P(std=np.ones((22, 3)))
    >>> metric.update(torch.zeros(2, 30, 22, 3), torch.zeros(2, 30, 22, 3))
    >>> float(metric.compute())
    0.0
    """

    declared = "l2p"


class L2Q(DeclaredMean):
    """L2Q of in-betweening: `update(predicted [clips, frames, joints, 4], target)`, unit quaternions of either sign.

    >>> metric = L2Q()
    >>> still = torch.tensor([1.0, 0.0, 0.0, 0.0]).expand(2, 30, 22, 4)
    >>> metric.update(still, -still)
    >>> float(metric.compute())
    0.0
    """

    declared = "l2q"


class NPSS(DeclaredMean):
    """Distance of power spectra: `update(predicted [clips, frames, numbers], target)`, all clips of one length.

    >>> metric = NPSS()
    >>> wave = torch.sin(torch.arange(30.0))[None, :, None]
    >>> metric.update(wave, 2 * wave)  # the spectra are normalised
    >>> round(float(metric.compute()), 6)
    0.0
    """

    declared = "npss"


class MotionMean(Metric):
    """A metric of `eval.metrics.physical` or `physical_published` by name, averaged over motions.

    `update` takes motions [frames, 22, 3] in metres, y up, of any lengths, each with its own floor (`ground_height`).
    Motions are weighted by their seconds; those with nothing to measure, such as contacts, are ignored. This is the
    mean of `motionkit eval --table physical`. Raises `KeyError` for a name that is not declared.

    >>> metric = MotionMean("bone_length_drift", fps=60)
    >>> metric.update([torch.rand(1, 22, 3).expand(90, 22, 3)])
    >>> float(metric.compute())
    0.0
    """

    full_state_update = False
    is_differentiable = False
    total: Tensor
    seconds: Tensor

    def __init__(self, declared: str, fps: Framerate, **settings: Any) -> None:
        super().__init__(**settings)
        self.metric_name, self.fps = find_metric(declared).name, parse_fps(fps)
        self.add_state("total", torch.zeros((), dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("seconds", torch.zeros((), dtype=torch.float64), dist_reduce_fx="sum")

    @property
    def higher_is_better(self) -> bool | None:  # type: ignore[override]
        """As the metric is declared."""
        return find_metric(self.metric_name).higher_is_better

    def update(self, motions: Sequence[Float[Tensor, "_frames joints 3"]]) -> None:
        """Add motions. Raises as the function."""
        function = find_metric(self.metric_name).function
        over_floor = "floor" in signature(function).parameters
        for motion in motions:
            positions, seconds = array_of(motion), len(motion) / float(self.fps)
            floor = {"floor": ground_height(positions, self.fps) / 1000.0} if over_floor else {}
            value = function(positions, float(self.fps), **floor)
            if value is not None:
                assert isinstance(value, float)
                self.total += seconds * value
                self.seconds += seconds

    def compute(self) -> Tensor:
        """The mean over motions, float64. Raises `ValueError` if none could be measured."""
        mean = MeanSums(float(self.total), float(self.seconds)).mean
        return torch.tensor(mean, dtype=torch.float64, device=self.total.device)
