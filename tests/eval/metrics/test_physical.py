"""Feet, floor, roughness, bones: performances whose feet are planted by construction, at every framerate; games."""

from fractions import Fraction
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eval.metrics.metric import Metric
from eval.metrics.physical import (
    METRICS,
    bone_length_drift,
    contact_share,
    foot_rests,
    ground_height,
    height_speed_agreement,
    jerk,
    jitter,
    slide_share,
    slide_speed,
)
from motionkit.fields.motion_field import to_motion
from motionkit.fields.resample import resample_positions
from tests.helpers.analytic import analytic_motion

RATES = ("20", "24000/1001", "25", "30", "60", "100", "120")


@lru_cache
def walk(fps: str = "120", seed: int = 3, seconds: float = 8.0) -> np.ndarray:
    """A walk on a floor at y = 0 whose standing feet stand exactly still."""
    field = analytic_motion("walk", seconds, seed)
    positions = to_motion(field, Fraction(fps)).joint_positions
    positions.setflags(write=False)  # all tests have the same
    return positions


def drifting(positions: np.ndarray, fps: float, speed: float) -> np.ndarray:
    """The whole body slides sideways."""
    moved = positions.astype(np.float64)
    moved[..., 0] += (0.6 * speed * np.arange(len(moved)) / fps)[:, None]
    moved[..., 2] += (0.8 * speed * np.arange(len(moved)) / fps)[:, None]
    return moved


@pytest.mark.parametrize("fps", RATES)
def test_planted_feet_rest_and_a_body_that_drifts_slides_at_its_speed(fps: str) -> None:
    rate = float(Fraction(fps))
    positions = walk(fps)
    assert slide_speed(positions, rate) < 0.02
    assert slide_share(positions, rate) < 0.01
    assert slide_speed(drifting(positions, rate, 0.4), rate) == pytest.approx(0.4, abs=0.08)
    assert slide_share(drifting(positions, rate, 0.4), rate) > 0.85
    still = np.repeat(positions[:1], len(positions), axis=0)
    assert slide_speed(drifting(still, rate, 0.4), rate) == pytest.approx(0.4, rel=1e-6)
    assert slide_share(drifting(still, rate, 0.24), rate) == 0.0
    assert slide_share(drifting(still, rate, 0.26), rate) == 1.0
    assert height_speed_agreement(drifting(still, rate, 0.26), rate) == 0.0


@pytest.mark.parametrize("metric", METRICS, ids=lambda metric: metric.name)
def test_a_motion_has_the_same_figures_at_every_framerate(metric) -> None:
    native = walk()
    whole = metric.function(native, Fraction(120))
    for fps in RATES[:-1]:
        if metric.name == "jitter" and Fraction(fps) < 40:
            continue
        found = metric.function(resample_positions(native, Fraction(120), Fraction(fps)), Fraction(fps))
        assert found == pytest.approx(whole, rel=0.05, abs=0.5 if metric.name == "ground_height" else 0.003)


def test_contact_is_where_feet_are_planted_by_construction() -> None:
    field = analytic_motion("walk", 8.0, 3)
    positions = to_motion(field, Fraction(60)).joint_positions
    low, speed = foot_rests(positions, 60.0)
    planted = np.repeat(field.feet(np.arange(len(positions)) / 60.0)[2], 2, axis=1)
    throughout = np.logical_and.reduce([planted[k : k + len(low)] for k in range(7)])
    assert throughout.any()
    # What is planted all along is low and at rest; what is low and at rest may be planted for a part of it.
    assert low[throughout].mean() > 0.95
    assert speed[throughout].max() < 1e-4


def test_what_is_frozen_floats_or_shakes() -> None:
    positions = walk().astype(np.float64)
    frozen = np.repeat(positions[:1], 240, axis=0)
    assert slide_speed(frozen, 120.0) == slide_share(frozen, 120.0) == jerk(frozen, 120) == 0.0
    assert jitter(frozen, 120) == pytest.approx(0.0, abs=1e-9)
    assert contact_share(frozen, 120.0) == height_speed_agreement(frozen, 120.0) == 1.0
    raised = positions + np.array([0.0, 0.2, 0.0])
    assert ground_height(raised, 120.0) == pytest.approx(ground_height(positions, 120.0) + 200.0)
    rising = positions + np.linspace(0.0, 1.0, len(positions))[:, None, None] * [0.0, 1.0, 0.0]
    assert contact_share(rising, 120.0) < 0.2 < 0.9 < contact_share(positions, 120.0)
    noisy = positions + 3e-4 * np.random.default_rng(0).standard_normal(positions.shape)
    assert slide_speed(noisy, 120.0) == pytest.approx(slide_speed(positions, 120.0), abs=0.01)
    assert jerk(noisy, 120) == pytest.approx(jerk(positions, 120), rel=0.2)
    # Of noise up to 60 Hz the part from 10 to about 18; 1.538 is the median length of three axes' normal numbers.
    assert jitter(noisy - positions + frozen[:1], 120) == pytest.approx(0.3 * 1.538 * (8 / 60) ** 0.5, rel=0.12)


@lru_cache
def of_a_walk(metric: Metric) -> float:
    return metric.function(walk("60", seconds=3.0).astype(np.float64), Fraction(60))


@settings(max_examples=25)
@given(height=st.floats(-2, 2), yaw=st.floats(0, 6.3), x=st.floats(-9, 9))
def test_where_a_motion_stands_changes_nothing(height: float, yaw: float, x: float) -> None:
    turn = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    moved = walk("60", seconds=3.0).astype(np.float64) @ turn.T + [x, height, 0.0]
    for metric in METRICS:
        expected = of_a_walk(metric) + (1000.0 * height if metric.name == "ground_height" else 0)
        assert metric.function(moved, Fraction(60)) == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_bones_that_stretch_drift_and_noise_does_not() -> None:
    positions = np.repeat(walk()[:1].astype(np.float64), 480, axis=0)
    assert bone_length_drift(positions, 120.0) == pytest.approx(0.0, abs=1e-12)
    noisy = positions + 5e-4 * np.random.default_rng(0).standard_normal(positions.shape)
    assert bone_length_drift(noisy, 120.0) < 0.004
    growing = positions * np.linspace(1.0, 1.1, len(positions))[:, None, None]
    # Means over 0.5 s of a length that grows by a tenth in 4 s: 7/8 of it are between the first and the last.
    assert bone_length_drift(growing, 120.0) == pytest.approx(0.1 * 7 / 8 / 1.05, rel=0.01)


def test_too_short_to_say() -> None:
    positions = walk("60")
    assert slide_speed(positions[:6], 60.0) is None
    assert slide_speed(positions[:7], 60.0) is not None
    assert contact_share(positions[:3], 60.0) is height_speed_agreement(positions[:3], 60.0) is None
    assert jerk(positions[:30], 60) is jitter(positions[:30], 60) is None
    assert jitter(positions, 30) is None
    assert bone_length_drift(np.zeros((3, 22, 3)), 60.0) is None
    swinging = np.zeros((60, 22, 3))
    swinging[::2, :, 1] = 0.5
    assert slide_speed(swinging, 60.0) is None and contact_share(swinging, 60.0) == 0.0
    broken = positions.copy()
    broken[3, 4, 1] = np.nan
    for metric in METRICS:
        with pytest.raises(ValueError, match="NaN"):
            metric.function(broken, Fraction(60))
