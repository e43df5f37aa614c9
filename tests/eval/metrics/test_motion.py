"""Errors of motions against loops and libraries: positions, vectors, derivatives, feet; PSNR, SSIM, L2P, L2Q, NPSS."""

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial import procrustes
from scipy.spatial.transform import Rotation
from skimage.metrics import structural_similarity

from eval.metrics.motion import (
    derivative_error,
    l2p,
    l2q,
    mean_vector_distance,
    mpjpe_global,
    mpjpe_procrustes,
    mpjpe_root_aligned,
    mre,
    npss,
    psnr,
    rotation_angle_error,
    skating_speed,
    ssim,
)

POSES = np.random.default_rng(0).normal(size=(40, 22, 3))


def test_mpjpe_of_a_shift_and_of_one_joint_off_by_a_known_distance() -> None:
    shifted, moved = POSES + np.array([0.3, 0.0, 0.4]), POSES.copy()
    moved[:, 5, 1] += 0.22
    for predicted, in_world, aligned in ((shifted, 0.5, 0.0), (moved, 0.01, 0.01)):
        assert mpjpe_global(predicted, POSES) == pytest.approx(in_world, rel=1e-9)
        assert mpjpe_root_aligned(predicted, POSES) == pytest.approx(aligned, rel=1e-9, abs=1e-12)


def test_procrustes_undoes_a_similarity_but_no_mirror_and_agrees_with_scipy() -> None:
    rotation = Rotation.from_euler("xyz", [0.3, -1.0, 2.0]).as_matrix()
    assert mpjpe_procrustes(1.7 * POSES @ rotation.T + 5.0, POSES) == pytest.approx(0.0, abs=1e-12)
    assert mpjpe_procrustes(POSES * [-1, 1, 1], POSES) > 0.1
    noisy = POSES + np.random.default_rng(2).normal(size=POSES.shape) * 0.2
    expected = []
    for predicted, true in zip(noisy, POSES, strict=True):
        a, b, _ = procrustes(true, predicted)
        expected.append(np.linalg.norm((a - b) * np.linalg.norm(true - true.mean(0)), axis=-1).mean())
    assert mpjpe_procrustes(noisy, POSES) == pytest.approx(np.mean(expected), rel=1e-9)


def test_mre_is_the_root_mean_square_and_the_norm_is_beside_it() -> None:
    predicted = np.tile([1.0, -1.0, 1.0, 1.0], (10, 1))
    assert mre(predicted, np.zeros((10, 4))) == 1.0
    assert mean_vector_distance(predicted, np.zeros((10, 4))) == 2.0


def test_derivative_errors_agree_with_loops_over_both_motions() -> None:
    predicted, target = np.random.default_rng(0).normal(size=(2, 9, 4, 3))
    motions = [list(predicted), list(target)]
    for order in (1, 2, 3):
        motions = [[(after - before) * 25.0 for before, after in pairwise(values)] for values in motions]
        expected = np.mean(
            [np.sqrt(((a[j] - b[j]) ** 2).sum()) for a, b in zip(*motions, strict=True) for j in range(4)]
        )
        assert derivative_error(predicted, target, 25.0, order=order) == pytest.approx(expected, rel=1e-12)


def test_rotation_error_is_the_angle_between_whatever_the_signs() -> None:
    rng = np.random.default_rng(5)
    target = Rotation.random(60, random_state=rng)
    axis = rng.normal(size=(60, 3))
    angle = np.concatenate(([1e-7, np.pi], rng.uniform(0, np.pi, 58)))
    turn = Rotation.from_rotvec(angle[:, None] * axis / np.linalg.norm(axis, axis=1, keepdims=True))
    predicted = rng.choice([-1.0, 1.0], size=(60, 1)) * (target * turn).as_quat()
    for k in range(60):
        found = rotation_angle_error(predicted[k].reshape(1, 1, 4), target.as_quat()[k].reshape(1, 1, 4))
        assert found == pytest.approx(np.degrees(angle[k]), rel=1e-6)


def test_skating_agrees_with_loops() -> None:
    feet, heights = np.random.default_rng(2).uniform(0, 0.1, size=(30, 4, 3)), (0.08, 0.04) * 2
    total = 0.0
    for now, after in pairwise(feet):
        speeds = [float(np.hypot(b[0] - a[0], b[2] - a[2])) * 10 for a, b in zip(now, after, strict=True)]
        total += sum(v * (2 - 2 ** min(max(a[1] / h, 0), 1)) for v, a, h in zip(speeds, now, heights, strict=True))
    assert skating_speed(feet, 10.0) == pytest.approx(total / (29 * 4), rel=1e-12)


def test_ssim_agrees_with_scikit_image_and_is_symmetric() -> None:
    rng = np.random.default_rng(0)
    x = np.cumsum(rng.normal(size=(40, 5)), axis=0) * 0.05 + 0.5
    y = x + 0.03 * rng.normal(size=x.shape)
    expected = structural_similarity(x, y, win_size=7, data_range=1.0, channel_axis=-1)
    assert ssim(x, y) == pytest.approx(float(expected), rel=1e-9)
    assert ssim(y, x) == pytest.approx(ssim(x, y), rel=1e-12)
    assert ssim(np.stack((x, x)), np.stack((y, x))) == pytest.approx((ssim(x, y) + 1) / 2)


def test_psnr_counts_synthesised_frames_only() -> None:
    target, synthesised = np.zeros((10, 4)), np.arange(10) % 2 == 1
    predicted = np.where(synthesised[:, None], 0.1, target)
    assert psnr(predicted, target, synthesised) == pytest.approx(20.0)
    assert psnr(predicted, target, np.ones(10, dtype=bool)) == pytest.approx(10 * math.log10(2 / 0.01))
    assert psnr(predicted, target, ~synthesised) == math.inf
    assert psnr(predicted, target, ~synthesised, 100.0) == 100.0


def test_l2p_is_a_norm_of_the_whole_pose() -> None:
    rng = np.random.default_rng(1)
    predicted, target = rng.normal(size=(2, 3, 5, 4, 3))
    std = rng.uniform(0.5, 2, size=(4, 3))
    norms = []
    for c, t in np.ndindex(3, 5):
        scaled = ((predicted[c, t, j, k] - target[c, t, j, k]) / std[j, k] for j, k in np.ndindex(4, 3))
        norms.append(math.sqrt(sum(each**2 for each in scaled)))
    assert l2p(predicted, target, std) == pytest.approx(np.mean(norms), rel=1e-12)


def test_l2q_knows_that_both_signs_are_one_rotation() -> None:
    rng = np.random.default_rng(2)
    predicted, target = (Rotation.random(24, random_state=seed).as_quat().reshape(2, 3, 4, 4) for seed in (0, 1))
    signs = rng.choice([-1.0, 1.0], size=(2, 3, 4, 1))
    assert l2q(predicted * signs, target) == pytest.approx(l2q(predicted, target), rel=1e-12)
    assert l2q(-target, target) == 0.0
    # A turn by θ is a chord of 2·sin(θ/4) between unit quaternions; four joints make it twice as long.
    turned = Rotation.from_euler("y", 0.8) * Rotation.from_quat(target.reshape(-1, 4))
    assert l2q(turned.as_quat().reshape(target.shape), target) == pytest.approx(2 * 2 * math.sin(0.2), rel=1e-9)


def npss_by_loops(predicted: np.ndarray, target: np.ndarray) -> float:
    total = weights = 0.0
    clips, frames, numbers = target.shape
    for clip, number in np.ndindex(clips, numbers):
        powers = []
        for signal in (predicted[clip, :, number], target[clip, :, number]):
            angles = 2 * np.pi * np.outer(np.arange(frames), np.arange(frames)) / frames
            powers.append((np.cos(angles) @ signal) ** 2)
        distance, carried = 0.0, 0.0
        for p, q in zip(powers[0] / powers[0].sum(), powers[1] / powers[1].sum(), strict=True):
            carried += p - q
            distance += abs(carried)
        total += powers[1].sum() * distance
        weights += powers[1].sum()
    return total / weights


def test_npss_agrees_with_cosine_sums_and_counts_power_alone() -> None:
    rng = np.random.default_rng(3)
    predicted, target = rng.normal(size=(2, 3, 20, 4)) * np.array([1.0, 2.0, 0.1, 5.0])
    assert npss(predicted, target) == pytest.approx(npss_by_loops(predicted, target), rel=1e-10)
    assert npss(target, target) == 0.0
    assert npss(3.0 * target, target) == pytest.approx(0.0, abs=1e-12)
    assert npss(predicted, target) != pytest.approx(npss(target, predicted), rel=1e-3)
    still = target * [1.0, 1.0, 1.0, 0.0]
    assert npss(predicted, still) == pytest.approx(npss(predicted[..., :3], target[..., :3]), rel=1e-12)
    assert math.isfinite(npss(np.zeros_like(target), target))


def test_refusals() -> None:
    clip, quaternions = np.zeros((2, 8, 3)), np.full((2, 8, 3, 4), 0.5)
    broken, still = np.full((2, 8, 3), np.nan), np.zeros((3, 2, 3))
    for call, reason in (
        (lambda: mpjpe_global(clip[:0], clip[:0]), "no frames"),
        (lambda: mpjpe_root_aligned(broken, clip), "NaN"),
        (lambda: npss(clip, clip), "no power"),
        (lambda: ssim(clip[:, :6], clip[:, :6]), "at least 7"),
        (lambda: psnr(clip, clip, np.zeros(8, dtype=bool)), "no frame is synthesised"),
        (lambda: l2q(0.8 * quaternions, quaternions), "predicted: quaternions must have unit length"),
        (lambda: derivative_error(still, still, 20.0, order=3), "at least 4 frames"),
        (lambda: derivative_error(clip, clip, 0.0, order=1), "fps must be positive"),
    ):
        with pytest.raises(ValueError, match=reason):
            call()
