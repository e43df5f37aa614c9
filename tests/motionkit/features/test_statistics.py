from pathlib import Path

import numpy as np
import pytest

from motionkit.core.moments import moments
from motionkit.features import statistics
from motionkit.features.layout import vector_layout

PART = vector_layout(22)


def published(seed: int = 0) -> statistics.Statistics:
    rng = np.random.default_rng(seed)
    rows = rng.normal(loc=rng.normal(size=263), scale=rng.uniform(0.5, 1.5, 263), size=(200, 263))
    return statistics.block_statistics(moments(rows), "humanml3d", 22)


def evaluators(plain: statistics.Statistics) -> statistics.Statistics:
    """The published evaluators' weighting: four root numbers and four contacts, std divided by 5 twice."""
    std = plain.std.copy()
    std[:4] /= 25
    std[259:] /= 25
    return statistics.Statistics("humanml3d", plain.mean, std)


def test_the_std_is_averaged_inside_each_block() -> None:
    rows = np.random.default_rng(1).normal(size=(50, 263)) * np.arange(1, 264)
    found = statistics.block_statistics(moments(rows), "humanml3d", 22)
    for block in PART.blocks:
        assert np.allclose(found.std[block], rows.std(0)[block].mean())
    assert np.allclose(found.restore(found.standardise(rows)), rows, atol=1e-3)


def test_the_two_signatures_are_distinguished() -> None:
    plain = published()
    weighted = evaluators(plain)
    statistics.check_statistics(plain, 22, "published")
    statistics.check_statistics(weighted, 22, "evaluator")
    with pytest.raises(ValueError, match="these are evaluator statistics"):
        statistics.check_statistics(weighted, 22, "published")
    with pytest.raises(ValueError, match="these are published statistics"):
        statistics.check_statistics(plain, 22, "evaluator")
    uneven = statistics.Statistics("humanml3d", plain.mean, np.linspace(1, 2, 263))
    with pytest.raises(ValueError, match="varies inside numbers 1 to 2"):
        statistics.check_statistics(uneven, 22, "published")
    with pytest.raises(ValueError, match="have 251 numbers, these have 263"):
        statistics.check_statistics(plain, 21, "published")


def test_signatures_of_the_real_files(captures: Path, golden_humanml3d: Path) -> None:
    def read(mean: Path, std: Path) -> statistics.Statistics:
        return statistics.Statistics("humanml3d", np.load(mean).astype(np.float64), np.load(std).astype(np.float64))

    plain = read(golden_humanml3d / "Mean.npy", golden_humanml3d / "Std.npy")
    statistics.check_statistics(plain, 22, "published")
    folder = captures / "evaluator-statistics"
    for name, num_joints in (("t2m", 22), ("kit", 21)):
        weighted = read(folder / f"{name}_mean.npy", folder / f"{name}_std.npy")
        statistics.check_statistics(weighted, num_joints, "evaluator")
        if name == "t2m":
            assert np.allclose(evaluators(plain).std, weighted.std, rtol=0.02)


def test_vectors_that_never_vary_are_refused() -> None:
    with pytest.raises(ValueError, match="every std above 0"):
        statistics.block_statistics(moments(np.zeros((2, 263))), "native", 22)
