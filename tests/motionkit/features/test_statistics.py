from pathlib import Path

import numpy as np
import pytest

from motionkit.features import statistics
from motionkit.features.layout import vector_layout

PART = vector_layout(22)


def published(seed: int = 0) -> statistics.Statistics:
    rng = np.random.default_rng(seed)
    std = np.empty(263)
    for block in PART.blocks:
        std[block] = rng.uniform(0.5, 1.5)
    return statistics.Statistics("humanml3d", rng.normal(size=263), std)


def evaluators(plain: statistics.Statistics) -> statistics.Statistics:
    """The published evaluators' weighting: four root numbers and four contacts, std divided by 5 twice."""
    std = plain.std.copy()
    std[:4] /= 25
    std[259:] /= 25
    return statistics.Statistics("humanml3d", plain.mean, std)


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
