"""The registry: what it says of each metric is so; streams equal the whole, whatever the batches and ranks."""

import inspect

import numpy as np
import pytest

from eval.metrics.metric import MeanStream, MeanSums, Metric, all_metrics, find_metric
from eval.metrics.retrieval import r_precision

METRICS = tuple(all_metrics().values())
MEANS = [metric for metric in METRICS if metric.weight is not None]
FIRST_ARGUMENTS = {
    "real, generated": ["real", "generated"],
    "predicted, target": ["predicted", "target"],
    "predicted, target, fps": ["predicted", "target", "fps"],
    "queries, candidates": ["queries", "candidates"],
    "scores, labels": ["scores", "labels"],
}


def test_names_are_unique_and_found() -> None:
    assert {"accuracy", "fid_test", "r_precision_top3", "npss", "jerk_error"} < all_metrics().keys()
    assert find_metric("fid").higher_is_better is False
    with pytest.raises(KeyError, match="there is no metric 'fidd': accuracy,"):
        find_metric("fidd")


@pytest.mark.parametrize("metric", METRICS, ids=lambda metric: metric.name)
def test_arguments_come_in_the_order_that_is_said(metric: Metric) -> None:
    names = list(inspect.signature(metric.function).parameters)
    if metric.arguments == "one set":
        assert not set(names) & {"real", "generated", "predicted", "target"}
    else:
        first = FIRST_ARGUMENTS[metric.arguments]
        assert names[: len(first)] == first
    assert metric.version >= 1
    assert metric.source


def arrays_of(metric: Metric, rng: np.random.Generator) -> tuple[tuple[np.ndarray, ...], dict[str, object]]:
    """What a metric takes: sequences (or clips) stacked along a first axis by which batches are cut, and settings."""
    motion = rng.normal(size=(2, 12, 20, 4, 3)) * 0.05
    per_second = {"fps": 30.0}
    rotations = rng.normal(size=(2, 12, 20, 4, 4))
    rotations /= np.linalg.norm(rotations, axis=-1, keepdims=True)
    vectors = rng.normal(size=(2, 12, 20, 6))
    known: dict[str, tuple[tuple[np.ndarray, ...], dict[str, object]]] = {
        "accuracy": ((rng.normal(size=(12, 20, 5)), rng.integers(5, size=(12, 20))), {}),
        "mre": (tuple(vectors), {}),
        "clip_score": (tuple(vectors), {}),
        "tmr_score": (tuple(vectors), {}),
        "mean_vector_distance": (tuple(vectors), {}),
        "velocity_error": (tuple(motion), per_second),
        "acceleration_error": (tuple(motion), per_second),
        "jerk_error": (tuple(motion), per_second),
        "skating_speed": ((motion[0],), per_second),
        "psnr": ((*vectors, np.tile(np.arange(20) % 3 == 1, (12, 1))), {}),
        "ssim": (tuple(vectors), {}),
        "l2p": (tuple(motion), {"std": rng.uniform(0.5, 1, size=(4, 3))}),
        "l2q": (tuple(rotations), {}),
        "l2q_as_signed": (tuple(rotations), {}),
        "rotation_angle_error": (tuple(rotations), {}),
        "npss": (tuple(vectors), {}),
    }
    return known.get(metric.name, (tuple(motion), {}))


@pytest.mark.parametrize("metric", [m for m in MEANS if m.name != "multimodality"], ids=lambda metric: metric.name)
def test_streams_do_not_depend_on_batches_or_ranks(metric: Metric) -> None:
    arrays, settings = arrays_of(metric, np.random.default_rng(0))
    clips_at_once = metric.name in ("l2p", "l2q", "l2q_as_signed", "npss")
    frames_of = None if clips_at_once else (lambda batch: batch)

    def streamed(ranks: int) -> float:
        streams = [MeanStream(metric) for _ in range(ranks)]
        for index in range(12):
            batch = [array[index : index + 1] if frames_of is None else array[index] for array in arrays]
            # Sequences of different lengths, so that a wrong weight shows.
            if frames_of is not None:
                batch = [array[: 8 + index] for array in batch]
            streams[index % ranks].update(*batch, **settings)
        for other in streams[1:]:
            streams[0].merge(other)
        return streams[0].value

    once = streamed(1)
    assert streamed(3) == pytest.approx(once, rel=1e-12)
    if clips_at_once:
        assert once == pytest.approx(metric.function(*arrays, **settings), rel=1e-10)
    elif metric.name in PER_FRAME:
        joined = [np.concatenate([array[index][: 8 + index] for index in range(12)]) for array in arrays]
        assert once == pytest.approx(metric.function(*joined, **settings), rel=1e-10)


PER_FRAME = {
    "accuracy", "mpjpe", "mpjpe_global", "mpjpe_procrustes", "mre", "mean_vector_distance",
    "rotation_angle_error", "clip_score", "tmr_score",
}  # fmt: skip


def test_r_precision_of_pools_merges() -> None:
    rng = np.random.default_rng(0)
    queries = rng.normal(size=(96, 4))
    candidates = queries + rng.normal(size=(96, 4))
    pools = [
        r_precision(queries[k : k + 32], candidates[k : k + 32], rng=np.random.default_rng(0)) for k in (0, 32, 64)
    ]
    merged = pools[0].merged(pools[1]).merged(pools[2])
    np.testing.assert_allclose(merged.top, np.mean([pool.top for pool in pools], axis=0), rtol=1e-12)
    distance = np.linalg.norm(queries - candidates, axis=1).mean()
    assert merged.matching_distance == pytest.approx(distance, rel=1e-12)
    assert merged.num_queries == 96


def test_streams_refuse_what_cannot_be_averaged() -> None:
    with pytest.raises(ValueError, match="kid is not a mean"):
        MeanStream(find_metric("kid"))
    with pytest.raises(ValueError, match="no batch was added"):
        _ = MeanStream(find_metric("ssim")).value
    with pytest.raises(ValueError, match="a stream of ssim cannot take in one of psnr"):
        MeanStream(find_metric("ssim")).merge(MeanStream(find_metric("psnr")))
    with pytest.raises(ValueError, match="value nan and weight 1"):
        MeanSums().added(float("nan"), 1.0)
    with pytest.raises(ValueError, match="weight 0"):
        MeanSums().added(1.0, 0.0)
