"""The field's own figures: known answers, loops over frames from their definitions, and what the framerate does."""

import numpy as np
import pytest

from eval.metrics.physical_published import (
    METRICS,
    gmd_skating_ratio,
    humanml3d_contact_share,
    kimodo_foot_skate,
    kimodo_skate_ratio,
    mbench_foot_floating,
    mbench_foot_sliding,
    mbench_penetration,
    mdm_contact_loss,
    mdm_contact_share,
    physdiff_float,
    physdiff_penetrate,
    physdiff_skate,
)

TOES, FEET = (10, 11), (7, 10, 8, 11)


def sliding(fps: float, speed: float, height: float = 0.0, seconds: float = 2.0) -> np.ndarray:
    """A body whose lowest joints, the toes, slide together at a height; nothing else is near the floor."""
    positions = np.ones((int(seconds * fps) + 1, 22, 3))
    positions[:, TOES, 1] = height
    positions[..., 0] += (0.6 * speed * np.arange(len(positions)) / fps)[:, None]
    positions[..., 2] += (0.8 * speed * np.arange(len(positions)) / fps)[:, None]
    return positions


def wandering(seed: int, num_frames: int = 60) -> np.ndarray:
    """Joints that walk at random about the floor, so that every threshold is passed now and then."""
    rng = np.random.default_rng(seed)
    positions = np.cumsum(rng.normal(scale=0.02, size=(num_frames, 22, 3)), axis=0)
    positions[..., 1] = np.abs(positions[..., 1]) * 0.2 + rng.normal(scale=0.004, size=(num_frames, 22))
    return positions


def test_thresholds_are_per_frame_where_their_projects_count_frames() -> None:
    for fps in (20.0, 40.0):
        per_frame = fps / 20.0
        assert gmd_skating_ratio(sliding(fps, 1.7 * per_frame), fps) == 1.0
        assert gmd_skating_ratio(sliding(fps, 0.49 * per_frame), fps) == 0.0
        num_steps = int(2 * fps)
        # Just too fast, and with zeros beyond the ends the average is too slow for two steps at either.
        assert gmd_skating_ratio(sliding(fps, 0.51 * per_frame), fps) == pytest.approx((num_steps - 4) / num_steps)
        assert gmd_skating_ratio(sliding(fps, 1.7 * per_frame, height=0.051), fps) == 0.0
        assert mdm_contact_share(sliding(fps, 0.19 * per_frame), fps) == 1.0
        assert mdm_contact_share(sliding(fps, 0.21 * per_frame), fps) == 0.0
        assert mdm_contact_loss(sliding(fps, 0.19 * per_frame), fps) == pytest.approx(0.0095**2 / 3)
        assert humanml3d_contact_share(sliding(fps, 0.89 * per_frame), fps) == 1.0
        assert humanml3d_contact_share(sliding(fps, 0.90 * per_frame), fps) == 0.0
        assert mbench_foot_sliding(sliding(fps, 1.0), fps) == pytest.approx(1.0 / fps, rel=1e-5)
        assert mbench_foot_sliding(sliding(fps, 1.0, height=0.03), fps) == 0.0
        assert mbench_foot_sliding(sliding(fps, 0.19 * per_frame, height=0.9), fps) == pytest.approx(0.0095, rel=1e-5)
        assert physdiff_skate(sliding(fps, 1.0), fps) == pytest.approx(1000.0 / fps)
        assert physdiff_skate(sliding(fps, 1.0, height=0.006), fps) == 0.0
        assert kimodo_foot_skate(sliding(fps, 0.3), fps) == pytest.approx(0.3, rel=1e-5)
        assert kimodo_skate_ratio(sliding(fps, 0.21), fps) == pytest.approx(1.0, rel=1e-5)
        assert kimodo_skate_ratio(sliding(fps, 0.19), fps) == 0.0
        assert kimodo_foot_skate(sliding(fps, 0.3, height=0.051), fps) == 0.0


def test_heights_are_over_the_floor_that_is_named() -> None:
    sunk, hung = sliding(20.0, 0.0, height=0.485), sliding(20.0, 0.0, height=0.53)
    assert physdiff_penetrate(sunk, 20.0, floor=0.5) == pytest.approx(10.0)
    assert mbench_penetration(sunk, 20.0, floor=0.5) == pytest.approx(0.015)
    assert physdiff_float(sunk, 20.0, floor=0.5) == physdiff_penetrate(hung, 20.0, floor=0.5) == 0.0
    assert physdiff_float(hung, 20.0, floor=0.5) == pytest.approx(25.0)
    assert mbench_penetration(hung, 20.0, floor=0.5) == 0.0


def test_feet_that_hang_by_mbench() -> None:
    # A statue on wheels: the toes touch, and go as the root goes, in every frame.
    assert mbench_foot_floating(sliding(20.0, 1.0), 20.0) == 1.0
    # In the air nothing touches, and each toe's frames count half; under 1 mm a frame the root rests.
    assert mbench_foot_floating(sliding(20.0, 1.0, height=0.5), 20.0) == 1.0
    assert mbench_foot_floating(sliding(20.0, 0.019), 20.0) == 0.0
    planted = sliding(20.0, 1.0)
    planted[:, TOES] = planted[0, TOES]
    assert mbench_foot_floating(planted, 20.0) == 0.0
    assert mbench_foot_floating(planted + np.array([0.0, 0.5, 0.0]), 20.0) == 0.0
    one = sliding(20.0, 1.0)
    one[:, TOES[1]] = planted[:, TOES[1]]
    # One of two that touch rests: no frame hangs; the other one lifted, the first alone decides.
    assert mbench_foot_floating(one, 20.0) == 0.0
    one[:, TOES[1], 1] = 0.5
    one[:, TOES[1], 0] += 0.1 * (-1.0) ** np.arange(len(one))
    assert mbench_foot_floating(one, 20.0) == 1.0
    # The root rests, both toes are in the air, and the left one goes to and fro.
    waving = sliding(20.0, 0.0, height=0.5)
    waving[:, TOES, 2] += 0.05 * np.arange(len(waving))[:, None]
    waving[:, TOES[0], 0] += 0.3 * np.sin(2 * np.pi * np.arange(len(waving)) / 8)
    assert mbench_foot_floating(waving, 20.0) == 1.0


@pytest.mark.parametrize("seed", range(4))
def test_figures_agree_with_loops_over_frames(seed: int) -> None:
    positions = wandering(seed)
    num_steps = len(positions) - 1
    moved = {j: [positions[t + 1, j] - positions[t, j] for t in range(num_steps)] for j in FEET}
    height = {j: positions[:, j, 1] for j in range(22)}

    speeds = [(j, t, float(np.linalg.norm(moved[j][t])) * 30.0) for j in TOES for t in range(num_steps)]
    low_now = [v for j, t, v in speeds if height[j][t] < 0.05]
    assert kimodo_foot_skate(positions, 30.0) == pytest.approx(sum(low_now) / len(low_now), rel=1e-6)
    low_twice = [v for j, t, v in speeds if height[j][t] < 0.05 and height[j][t + 1] < 0.05]
    assert kimodo_skate_ratio(positions, 30.0) == pytest.approx(np.mean(np.array(low_twice) > 0.2), rel=1e-6)

    total = 0.0
    for t in range(num_steps):
        j = min(range(22), key=lambda joint: height[joint][t])
        if height[j][t] <= 0.005 and height[j][t + 1] <= 0.005:
            step = positions[t + 1, j] - positions[t, j]
            total += 1000.0 * float(np.hypot(step[0], step[2]))
    assert physdiff_skate(positions, 30.0) == pytest.approx(total / num_steps)
    assert total > 0 and low_now and low_twice


@pytest.mark.parametrize("metric", METRICS, ids=lambda metric: metric.name)
def test_broken_motions_are_refused(metric) -> None:
    broken = wandering(0)
    broken[3, 10, 1] = np.inf
    with pytest.raises(ValueError, match="NaN or infinity"):
        metric.function(broken, 20.0)
    with pytest.raises(ValueError, match="at least 3 samples"):
        metric.function(wandering(0)[:2], 20.0)
