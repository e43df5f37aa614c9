"""What each metric is: unit, direction, version, source; and, where it is a mean, what it is a mean over."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from eval.metrics import (
    actions,
    feet,
    gaussian,
    inbetweening,
    neighbours,
    r_precision,
    reconstruction,
    signal,
)
from eval.metrics.checks import MeanSums

Array = npt.NDArray[np.generic]
Arguments = Literal["real, generated", "predicted, target", "queries, candidates", "scores, labels", "one set"]


@dataclass(frozen=True)
class Metric:
    """A metric as tables name it.

    `higher_is_better` is None where the best value is the real set's own. `version` is bumped when a value changes its
    meaning. `arguments` says what the function's first arrays are, in order. `weight` gives the weight of a batch from
    the function's arrays; it is None where the metric is no mean (a stream of such a metric needs other sums, or all
    rows). `exponent` is 2 where the metric is the root of a mean of squares.
    """

    name: str
    title: str
    unit: str
    higher_is_better: bool | None
    version: int
    source: str
    arguments: Arguments
    function: Callable[..., object] = field(repr=False)
    weight: Callable[..., float] | None = field(default=None, repr=False)
    exponent: int = 1


class MeanStream:
    """A metric over batches and ranks: `update` with what its function takes, `merge` other ranks, read `value`."""

    def __init__(self, metric: Metric) -> None:
        if metric.weight is None:
            raise ValueError(
                f"{metric.name} is not a mean over batches; its function needs all samples (docs/metrics.md)"
            )
        self._metric = metric
        self._weight = metric.weight
        self.sums = MeanSums()

    def update(self, *arrays: Array, **settings: object) -> None:
        """Add a batch; arrays by position, everything else by keyword."""
        value = self._metric.function(*arrays, **settings)
        assert isinstance(value, float)
        self.sums = self.sums.added(value**self._metric.exponent, self._weight(*arrays))

    def merge(self, other: "MeanStream") -> None:
        """Add what another rank's stream of the same metric has seen."""
        if other._metric.name != self._metric.name:
            raise ValueError(f"a stream of {self._metric.name} cannot take in one of {other._metric.name}")
        self.sums = self.sums.merged(other.sums)

    @property
    def value(self) -> float:
        """The metric over all batches so far."""
        return float(self.sums.mean ** (1 / self._metric.exponent))


def _frames(first: Array, *_: Array) -> float:
    return float(len(first))


def _steps(order: int) -> Callable[..., float]:
    return lambda first, *_: float(len(first) - order)


def _clips(first: Array, *_: Array) -> float:
    return float(np.prod(first.shape[:-2]))


def _clip_steps(order: int) -> Callable[..., float]:
    return lambda first, *_: float(np.prod(first.shape[:-3]) * (first.shape[-3] - order))


def _clips_times_frames(first: Array, *_: Array) -> float:
    return float(first.shape[0] * first.shape[1])


def _numbers(first: Array, *_: Array) -> float:
    return float(first.size)


def _true_power(_: Array, target: npt.NDArray[np.floating]) -> float:
    return inbetweening.npss_weight(target)


METRICS: tuple[Metric, ...] = (
    Metric("fid", "FID", "", False, 1, "Heusel et al. 2017", "real, generated", gaussian.fid),
    *(
        Metric(
            f"fid_{name}",
            f"FID ({title})",
            "",
            False,
            1,
            "ACTOR (Petrovich et al. 2021)",
            "real, generated",
            gaussian.fid,
        )
        for name, title in (("train", "training set"), ("test", "test set"))
    ),
    Metric("fid_infinity", "FID∞", "", False, 1, "Chong & Forsyth 2020", "real, generated", gaussian.fid_infinity),
    Metric("kid", "KID", "", False, 1, "Bińkowski et al. 2018", "real, generated", gaussian.kid),
    Metric("precision", "Precision", "", True, 1, "Kynkäänniemi et al. 2019", "real, generated", neighbours.prdc),
    Metric("recall", "Recall", "", True, 1, "Kynkäänniemi et al. 2019", "real, generated", neighbours.prdc),
    Metric("density", "Density", "", True, 1, "Naeem et al. 2020", "real, generated", neighbours.prdc),
    Metric("coverage", "Coverage", "", True, 1, "Naeem et al. 2020", "real, generated", neighbours.prdc),
    *(
        Metric(
            f"r_precision_top{rank}{direction}",
            f"R-Precision, top {rank}{title}",
            "",
            True,
            1,
            source,
            "queries, candidates",
            r_precision.r_precision,
        )
        for direction, title, source in (
            ("", "", "text-to-motion (Guo et al. 2022): a text asks for its motion"),
            ("_motion_asks", " (a motion asks)", "NeRM, appendix: a motion asks for its text"),
        )
        for rank in (1, 2, 3)
    ),
    Metric(
        "mm_dist",
        "MultiModal Dist",
        "",
        False,
        1,
        "text-to-motion (Guo et al. 2022)",
        "queries, candidates",
        r_precision.r_precision,
    ),
    Metric("diversity", "Diversity", "", None, 1, "text-to-motion; NeRM Eq. 7", "one set", actions.diversity),
    Metric(
        "diversity_with_replacement",
        "Diversity (with replacement)",
        "",
        None,
        1,
        "action-to-motion (Guo et al. 2020)",
        "one set",
        actions.diversity_with_replacement,
    ),
    Metric(
        "multimodality",
        "MultiModality",
        "",
        None,
        1,
        "NeRM Eq. 8",
        "one set",
        actions.multimodality,
        _frames,
    ),
    Metric(
        "multimodality_shared_pairs",
        "MultiModality (shared pairs)",
        "",
        None,
        1,
        "text-to-motion (Guo et al. 2022)",
        "one set",
        actions.multimodality_shared_pairs,
    ),
    *(
        Metric(name, title, "", None, 1, source, "one set", function)
        for name, title, source, function in (
            (
                "multimodality_by_class",
                "MultiModality (by action)",
                "motionkit: pairs of two different motions",
                actions.multimodality_by_class,
            ),
            (
                "multimodality_by_class_with_replacement",
                "MultiModality (by action, with replacement)",
                "action-to-motion (Guo et al. 2020)",
                actions.multimodality_by_class_with_replacement,
            ),
        )
    ),
    Metric(
        "accuracy",
        "Accuracy",
        "",
        True,
        1,
        "action-to-motion (Guo et al. 2020)",
        "scores, labels",
        actions.accuracy,
        _frames,
    ),
    Metric(
        "mpjpe",
        "MPJPE",
        "m",
        False,
        1,
        "motion-latent-diffusion; NeRM Table 4",
        "predicted, target",
        reconstruction.mpjpe_root_aligned,
        _frames,
    ),
    Metric(
        "mpjpe_global",
        "MPJPE (global)",
        "m",
        False,
        1,
        "Ionescu et al. 2014",
        "predicted, target",
        reconstruction.mpjpe_global,
        _frames,
    ),
    Metric(
        "mpjpe_procrustes",
        "MPJPE (Procrustes)",
        "m",
        False,
        1,
        "Gower 1975",
        "predicted, target",
        reconstruction.mpjpe_procrustes,
        _frames,
    ),
    Metric(
        "mre",
        "MRE",
        "raw",
        False,
        1,
        "NeRM Table 4, as a root mean square",
        "predicted, target",
        reconstruction.mre,
        _numbers,
        2,
    ),
    Metric(
        "mean_vector_distance",
        "MRE (L2 norm)",
        "raw",
        False,
        1,
        "NeRM Table 4",
        "predicted, target",
        reconstruction.mean_vector_distance,
        _frames,
    ),
    Metric(
        "rotation_angle_error",
        "Rotation error",
        "°",
        False,
        1,
        "geodesic distance on SO(3)",
        "predicted, target",
        reconstruction.rotation_angle_error,
        _frames,
    ),
    Metric(
        "velocity_error",
        "Velocity error",
        "m/s",
        False,
        1,
        "mean joint distance of differences",
        "predicted, target",
        reconstruction.velocity_error,
        _clip_steps(1),
    ),
    Metric(
        "acceleration_error",
        "Acceleration error",
        "m/s²",
        False,
        1,
        "Kanazawa et al. 2019",
        "predicted, target",
        reconstruction.acceleration_error,
        _clip_steps(2),
    ),
    Metric(
        "jerk_error",
        "Jerk error",
        "m/s³",
        False,
        1,
        "mean joint distance of third differences",
        "predicted, target",
        reconstruction.jerk_error,
        _clip_steps(3),
    ),
    Metric(
        "skating_speed",
        "Foot skating",
        "m/s",
        False,
        1,
        "Zhang et al. 2018; NeMF",
        "one set",
        feet.skating_speed,
        _steps(1),
    ),
    Metric(
        "skating_ratio",
        "Foot skating ratio",
        "",
        False,
        1,
        "GMD; CondMDI",
        "one set",
        feet.skating_ratio,
        _steps(1),
    ),
    Metric(
        "contact_consistency",
        "Contact consistency",
        "",
        True,
        1,
        "motionkit",
        "one set",
        feet.contact_consistency,
        _steps(1),
    ),
    Metric(
        "bone_length_variation",
        "Bone-length variation",
        "",
        False,
        1,
        "motionkit",
        "one set",
        reconstruction.bone_length_variation,
        _frames,
    ),
    Metric(
        "bone_length_error",
        "Bone-length error",
        "m",
        False,
        1,
        "motionkit",
        "predicted, target",
        reconstruction.bone_length_error,
        _frames,
    ),
    Metric("psnr", "PSNR", "dB", True, 1, "motionkit", "predicted, target", signal.psnr, _clips),
    Metric("ssim", "SSIM", "", True, 1, "Wang et al. 2004", "predicted, target", signal.ssim, _clips),
    Metric(
        "l2p", "L2P", "", False, 1, "Harvey et al. 2020", "predicted, target", inbetweening.l2p, _clips_times_frames
    ),
    Metric(
        "l2q", "L2Q", "", False, 1, "Harvey et al. 2020", "predicted, target", inbetweening.l2q, _clips_times_frames
    ),
    Metric(
        "l2q_as_signed",
        "L2Q (signs as they come)",
        "",
        False,
        1,
        "Harvey et al. 2020",
        "predicted, target",
        inbetweening.l2q_as_signed,
        _clips_times_frames,
    ),
    Metric(
        "npss", "NPSS", "", False, 1, "Gopalakrishnan et al. 2019", "predicted, target", inbetweening.npss, _true_power
    ),
)


def find_metric(name: str) -> Metric:
    """A metric by name; raises `KeyError` with the names there are."""
    for metric in METRICS:
        if metric.name == name:
            return metric
    raise KeyError(f"there is no metric {name!r}: {', '.join(metric.name for metric in METRICS)}")
