"""PSNR, SSIM, L2P, L2Q, NPSS: loops from the definitions, known answers, which side is true, refusals."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from skimage.metrics import structural_similarity

from eval.metrics.motion import l2p, l2q, npss, npss_weight, psnr, ssim, to_unit_range


def ssim_of_skimage(x: np.ndarray, y: np.ndarray) -> float:
    return float(structural_similarity(x, y, win_size=7, data_range=1.0, channel_axis=-1))


def test_ssim_agrees_with_scikit_image_and_is_symmetric() -> None:
    rng = np.random.default_rng(0)
    x = np.cumsum(rng.normal(size=(40, 5)), axis=0) * 0.05 + 0.5
    y = x + 0.03 * rng.normal(size=x.shape)
    assert ssim(x, y) == pytest.approx(ssim_of_skimage(x, y), rel=1e-9)
    assert ssim(y, x) == pytest.approx(ssim(x, y), rel=1e-12)
    assert ssim(x, x) == pytest.approx(1.0, rel=1e-14)
    assert 0.5 < ssim(x, y) < 1.0


def test_psnr_counts_synthesised_frames_only() -> None:
    target = np.zeros((10, 4))
    predicted = target.copy()
    synthesised = np.arange(10) % 2 == 1
    predicted[synthesised] = 0.1
    assert psnr(predicted, target, synthesised) == pytest.approx(20.0)
    assert psnr(predicted, target, np.ones(10, dtype=bool)) == pytest.approx(10 * math.log10(2 / 0.01))
    assert psnr(predicted, target, ~synthesised) == math.inf


def test_l2p_is_a_norm_of_the_whole_pose() -> None:
    rng = np.random.default_rng(1)
    predicted, target = rng.normal(size=(2, 3, 5, 4, 3))
    std = rng.uniform(0.5, 2, size=(4, 3))
    norms = [
        math.sqrt(
            sum(((predicted[c, t, j, k] - target[c, t, j, k]) / std[j, k]) ** 2 for j in range(4) for k in range(3))
        )
        for c in range(3)
        for t in range(5)
    ]
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
    for clip in range(clips):
        for number in range(numbers):
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


def test_npss_agrees_with_cosine_sums_and_its_weights_are_the_true_side() -> None:
    rng = np.random.default_rng(3)
    predicted, target = rng.normal(size=(2, 3, 20, 4)) * np.array([1.0, 2.0, 0.1, 5.0])
    assert npss(predicted, target) == pytest.approx(npss_by_loops(predicted, target), rel=1e-10)
    assert npss(target, target) == 0.0
    assert npss(3.0 * target, target) == pytest.approx(0.0, abs=1e-12)
    assert npss(predicted, target) != pytest.approx(npss(target, predicted), rel=1e-3)
    parts = [(npss(predicted[i : i + 1], target[i : i + 1]), npss_weight(target[i : i + 1])) for i in range(3)]
    merged = sum(value * weight for value, weight in parts) / sum(weight for _, weight in parts)
    assert npss(predicted, target) == pytest.approx(merged, rel=1e-12)


def test_npss_of_signals_without_power() -> None:
    target = np.random.default_rng(4).normal(size=(1, 8, 2))
    target[..., 1] = 0.0
    predicted = np.random.default_rng(5).normal(size=target.shape)
    assert npss(predicted, target) == pytest.approx(npss(predicted[..., :1], target[..., :1]), rel=1e-12)
    assert math.isfinite(npss(np.zeros_like(target), target))
    with pytest.raises(ValueError, match="no power"):
        npss(target, np.zeros_like(target))


def test_refusals() -> None:
    clip = np.zeros((2, 8, 3))
    broken = clip.copy()
    broken[0, 1] = np.nan
    with pytest.raises(ValueError, match="NaN"):
        npss(broken, clip)
    with pytest.raises(ValueError, match="NaN"):
        ssim(broken[0], clip[0])
    with pytest.raises(ValueError, match="at least 7"):
        ssim(clip[0, :6], clip[0, :6])
    with pytest.raises(ValueError, match="no frame is synthesised"):
        psnr(clip[0], clip[0], np.zeros(8, dtype=bool))
    with pytest.raises(ValueError, match="8 frames and 7 marks"):
        psnr(clip[0], clip[0], np.ones(7, dtype=bool))
    with pytest.raises(ValueError, match="not positive"):
        to_unit_range(clip[0], np.zeros(3), np.zeros(3))
    with pytest.raises(ValueError, match="not positive"):
        l2p(np.zeros((1, 2, 1, 3)), np.zeros((1, 2, 1, 3)), np.zeros((1, 3)))
    with pytest.raises(ValueError, match="predicted: quaternions must have unit length"):
        l2q(np.zeros((1, 2, 1, 4)), np.zeros((1, 2, 1, 4)))
