"""The registry, and means over batches: the whole's value, whatever the batches and ranks."""

import numpy as np
import pytest

from eval.metrics.metric import Metric
from eval.metrics.registry import METRICS, find_metric

MEANS = [metric for metric in METRICS.values() if metric.weight is not None and metric.name != "multimodality"]
OF_CLIPS = ("l2p", "l2q", "l2q_as_signed", "npss")
PER_FRAME = {
    "accuracy", "mpjpe", "mpjpe_global", "mpjpe_procrustes", "mre", "mean_vector_distance",
    "rotation_angle_error", "clip_score", "tmr_score",
}  # fmt: skip


def test_metrics_are_found_by_name() -> None:
    assert {"accuracy", "fid_test", "r_precision_top3", "recall_at_10_real_asked", "npss"} < METRICS.keys()
    assert find_metric("fid").higher_is_better is False
    with pytest.raises(KeyError, match="fidd"):
        find_metric("fidd")


def arrays_of(metric: Metric) -> tuple[tuple[np.ndarray, ...], dict[str, object]]:
    """What a metric takes: 12 sequences (or clips) along a first axis, and settings."""
    rng = np.random.default_rng(0)
    motion = rng.normal(size=(2, 12, 20, 4, 3)) * 0.05
    per_second = {"fps": 30.0}
    rotations = rng.normal(size=(2, 12, 20, 4, 4))
    rotations /= np.linalg.norm(rotations, axis=-1, keepdims=True)
    vectors = rng.normal(size=(2, 12, 20, 6))
    known: dict[str, tuple[tuple[np.ndarray, ...], dict[str, object]]] = {
        "accuracy": ((rng.normal(size=(12, 20, 5)), rng.integers(5, size=(12, 20))), {}),
        "skating_speed": ((motion[0],), per_second),
        "psnr": ((*vectors, np.tile(np.arange(20) % 3 == 1, (12, 1))), {}),
        "l2p": (tuple(motion), {"std": rng.uniform(0.5, 1, size=(4, 3))}),
        **dict.fromkeys(("velocity_error", "acceleration_error", "jerk_error"), (tuple(motion), per_second)),
        **dict.fromkeys(("l2q", "l2q_as_signed", "rotation_angle_error"), (tuple(rotations), {})),
        **dict.fromkeys(
            ("mre", "clip_score", "tmr_score", "mean_vector_distance", "ssim", "npss"), (tuple(vectors), {})
        ),
    }
    return known.get(metric.name, (tuple(motion), {}))


@pytest.mark.parametrize("metric", MEANS, ids=lambda metric: metric.name)
def test_means_do_not_depend_on_batches(metric: Metric) -> None:
    arrays, settings = arrays_of(metric)
    clips = metric.name in OF_CLIPS

    sums = np.zeros(2)
    for index in range(12):
        # Sequences of different lengths, so that a wrong weight shows.
        batch = [each[index : index + 1] if clips else each[index][: 8 + index] for each in arrays]
        sums += metric.weighted(*batch, **settings)
    mean = (sums[0] / sums[1]) ** (1 / metric.exponent)
    if clips:
        assert mean == pytest.approx(metric.function(*arrays, **settings), rel=1e-10)
    elif metric.name in PER_FRAME:
        joined = [np.concatenate([array[index][: 8 + index] for index in range(12)]) for array in arrays]
        assert mean == pytest.approx(metric.function(*joined, **settings), rel=1e-10)


def test_what_cannot_be_averaged_is_refused() -> None:
    for name, rows in (("kid", 3), ("ssim", 0), ("mean_vector_distance", 0)):
        with pytest.raises(ValueError, match=r"kid is not a mean|no frames"):
            find_metric(name).weighted(np.zeros((rows, 9, 2)), np.zeros((rows, 9, 2)))
