"""MPJPE and MRE: known answers, invariances, an independent Procrustes."""

import numpy as np
import pytest
from scipy.spatial import procrustes
from scipy.spatial.transform import Rotation

from eval.metrics.motion import mean_vector_distance, mpjpe_global, mpjpe_procrustes, mpjpe_root_aligned, mre
from eval.metrics.number import over_replications


@pytest.fixture
def poses() -> np.ndarray:
    return np.random.default_rng(0).normal(size=(40, 22, 3)).astype(np.float32)


def test_a_shift_is_seen_globally_and_not_root_aligned(poses: np.ndarray) -> None:
    shifted = poses + np.float32([0.3, 0.0, 0.4])
    assert mpjpe_global(shifted, poses) == pytest.approx(0.5, rel=1e-6)
    assert mpjpe_root_aligned(shifted, poses) == pytest.approx(0.0, abs=1e-6)


def test_one_joint_off_by_a_known_distance(poses: np.ndarray) -> None:
    moved = poses.astype(np.float64)
    moved[:, 5, 1] += 0.22
    assert mpjpe_global(moved, poses) == pytest.approx(0.01, rel=1e-9)
    assert mpjpe_root_aligned(moved, poses) == pytest.approx(0.01, rel=1e-9)


def test_procrustes_undoes_a_similarity_and_agrees_with_scipy(poses: np.ndarray) -> None:
    target = poses.astype(np.float64)
    rotation = Rotation.from_euler("xyz", [0.3, -1.0, 2.0]).as_matrix()
    assert mpjpe_procrustes(1.7 * target @ rotation.T + 5.0, target) == pytest.approx(0.0, abs=1e-12)
    noisy = target + np.random.default_rng(2).normal(size=target.shape) * 0.2
    expected = []
    for predicted, true in zip(noisy, target, strict=True):
        a, b, _ = procrustes(true, predicted)
        expected.append(np.linalg.norm((a - b) * np.linalg.norm(true - true.mean(0)), axis=-1).mean())
    assert mpjpe_procrustes(noisy, target) == pytest.approx(np.mean(expected), rel=1e-9)


def test_procrustes_does_not_mirror(poses: np.ndarray) -> None:
    assert mpjpe_procrustes(poses * np.float32([-1, 1, 1]), poses) > 0.1


def test_mre_is_the_root_mean_square_and_the_norm_is_beside_it() -> None:
    target = np.zeros((10, 4))
    predicted = np.tile([1.0, -1.0, 1.0, 1.0], (10, 1))
    assert mre(predicted, target) == 1.0
    assert mean_vector_distance(predicted, target) == 2.0


def test_refusals(poses: np.ndarray) -> None:
    with pytest.raises(ValueError, match="no frames"):
        mpjpe_global(poses[:0], poses[:0])
    broken = poses.copy()
    broken[3, 4] = np.nan
    with pytest.raises(ValueError, match="NaN"):
        mpjpe_root_aligned(broken, poses)


def test_interval_is_the_reference_protocols() -> None:
    values = [1.0, 2.0, 4.0, 5.0]
    result = over_replications(values)
    assert result.value == 3.0
    assert result.ci95 == pytest.approx(1.96 * np.std(values) / 2)
    assert over_replications([3.0]).ci95 == 0.0
    with pytest.raises(ValueError, match="not finite"):
        over_replications([1.0, float("nan")])
