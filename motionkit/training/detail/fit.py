"""Learn detail from takes at their native framerate, in closed form: ridge regression within takes.

Captures differ in their overall jitter, whatever the body does. So the regression is on deviations from each take's
mean, and sampled detail has the mean level of all takes.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from motionkit.core.shapes import Float, Float32, Float64
from motionkit.fields.detail.model import NUM_JOINTS, Detail, floors
from motionkit.fields.detail.slow_motion import (
    BAND_REACH,
    MARGIN,
    NUM_BANDS,
    SlowMotion,
    band_motion,
    band_power,
    slow_motion,
    to_body,
    with_ends,
)

RIDGE = 0.3
"""The penalty on squared weights, as a share of the number of frames; features have unit variance."""
MOST_QUANTILE = 0.999
LARGEST_DEVIATION = 4.0
"""Jumps of a capture are clipped at this many standard deviations."""


@dataclass(frozen=True, eq=False)
class _Take:
    """A take's slow motion, and its fast motion's log power above a floor."""

    features: Float32[np.ndarray, "frames features"]
    log_power: Float32[np.ndarray, "frames outputs"]


def fit_detail(
    takes: Sequence[Float[np.ndarray, "_frames joints 3"]], on_take: Callable[[], None] = lambda: None
) -> Detail:
    """Fit detail on captures at 120 fps, of the 22 joints, in metres, y up; `on_take` is called twice for each.

    Raises `ValueError` without takes.
    """
    if not takes:
        raise ValueError("detail is learnt from one take at least")
    seen = []
    for take in takes:
        positions = with_ends(take, MARGIN, MARGIN)
        power = band_power(positions).reshape(len(take), -1) + np.repeat(floors(), NUM_JOINTS)
        seen.append(_Take(slow_motion(positions).features.astype(np.float32), np.log(power).astype(np.float32)))
        on_take()
    frames = np.array([len(take) for take in takes], dtype=np.float64)
    means = np.array([take.features.mean(axis=0, dtype=np.float64) for take in seen])
    squares = np.array([np.square(take.features, dtype=np.float64).mean(axis=0) for take in seen])
    share = frames / frames.sum()
    centre = share @ means
    scale = 1.0 / np.sqrt(np.maximum(share @ squares - np.square(centre), 1e-6))
    weights = _within_takes(seen, centre, scale)
    levels = np.array([take.log_power.mean(axis=0, dtype=np.float64) for take in seen])
    levels -= (means - centre) * scale @ weights
    most = np.quantile(np.concatenate([take.log_power[::4] for take in seen]), MOST_QUANTILE, axis=0)
    own = [_detail(centre, scale, weights, level, most) for level in levels]
    mixing = _mixing(takes, own, on_take)
    return Detail(centre, scale, weights, share @ levels, most.astype(np.float64), mixing)


def _within_takes(
    seen: Sequence[_Take], centre: Float64[np.ndarray, "features"], scale: Float64[np.ndarray, "features"]
) -> Float64[np.ndarray, "features outputs"]:
    """Ridge regression of deviations from each take's means."""
    features, outputs = seen[0].features.shape[1], seen[0].log_power.shape[1]
    square, product, frames = np.zeros((features, features)), np.zeros((features, outputs)), 0
    for take in seen:
        state = (take.features - centre) * scale
        state -= state.mean(axis=0)
        square += state.T @ state
        product += state.T @ (take.log_power - take.log_power.mean(axis=0))
        frames += len(state)
    return np.asarray(np.linalg.solve(square + RIDGE * frames * np.eye(features), product))


def _detail(
    centre: Float64[np.ndarray, "features"],
    scale: Float64[np.ndarray, "features"],
    weights: Float64[np.ndarray, "features outputs"],
    level: Float64[np.ndarray, "outputs"],
    most: Float[np.ndarray, "outputs"],
) -> Detail:
    """The detail model before the covariance of joints is known."""
    nothing = np.zeros((NUM_BANDS, 3 * NUM_JOINTS, 3 * NUM_JOINTS))
    return Detail(centre, scale, weights, level, most.astype(np.float64), nothing)


def _mixing(
    takes: Sequence[Float[np.ndarray, "_frames joints 3"]], own: Sequence[Detail], on_take: Callable[[], None]
) -> Float64[np.ndarray, "bands coordinates coordinates"]:
    """Cholesky factors of the covariance in every band, joints normalised by their predicted strength."""
    coordinates = 3 * NUM_JOINTS
    covariance = np.zeros((NUM_BANDS, coordinates, coordinates))
    for take, detail in zip(takes, own, strict=True):
        positions = with_ends(take, MARGIN, MARGIN)
        slow: SlowMotion = slow_motion(positions)
        flat = positions[MARGIN - BAND_REACH : len(positions) - (MARGIN - BAND_REACH)]
        fast = band_motion(flat.reshape(len(flat), -1)).reshape(NUM_BANDS, len(take), NUM_JOINTS, 3)
        strength = np.sqrt(detail.power(slow) + floors()[:, None])
        relative = to_body(fast, slow.facing) / np.moveaxis(strength, 1, 0)[..., None]
        relative = np.clip(relative, -LARGEST_DEVIATION, LARGEST_DEVIATION).reshape(NUM_BANDS, len(take), coordinates)
        covariance += np.swapaxes(relative, 1, 2) @ relative
        on_take()
    joints = np.diagonal(covariance, axis1=1, axis2=2).reshape(NUM_BANDS, NUM_JOINTS, 3).sum(axis=2)
    size = np.repeat(np.sqrt(np.maximum(joints, 1e-12)), 3, axis=1)
    correlation = covariance / (size[:, :, None] * size[:, None, :])
    return np.asarray(np.linalg.cholesky(correlation + 1e-6 * np.eye(coordinates)))
