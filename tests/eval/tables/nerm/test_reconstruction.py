"""Errors of reconstructions whose errors are known; Table 4 as a whole: tests/nerm/test_stages.py."""

from fractions import Fraction

import numpy as np
import pytest

from eval.tables.nerm.reconstruction import (
    COUNT,
    DISTANCE,
    GLOBAL,
    error_cells,
    separate_windows,
    window_errors,
    window_truth,
)
from motionkit.core.skeleton import SMPL22
from motionkit.data.windows import cut_windows
from motionkit.features import field
from tests.helpers.nerm_corpus import analytic_positions, analytic_source

FPS = Fraction(60)
TRUTH = analytic_positions(np.arange(90) / 60, 1)
RAISED = TRUTH + np.float32([0.0, 0.05, 0.0])
TURNED = TRUTH[..., [2, 1, 0]] * np.float32([1, 1, -1]) + np.float32([3.0, 0.0, -2.0])
ONE_JOINT = TRUTH + 0.022 * (np.arange(66).reshape(22, 3) == 22).astype(np.float32)


@pytest.mark.parametrize(
    ("found", "aligned_mm", "global_mm", "mre"),
    [
        (ONE_JOINT, 1.0, 1.0, None),
        # 22 of the 263 numbers are heights: the root's and those of the other 21 joints.
        (RAISED, 0.0, 50.0, 0.05 * (22 / 263) ** 0.5),
        # Where a motion is and which way it faces does not count.
        (TURNED, None, None, 0.0),
    ],
)
def test_errors_are_those_of_the_difference(
    found: np.ndarray, aligned_mm: float | None, global_mm: float | None, mre: float | None
) -> None:
    cells = error_cells([window_errors(found, TRUTH, FPS, 2.0)])
    if aligned_mm is not None:
        assert cells["mpjpe"].value == pytest.approx(aligned_mm, abs=1e-3)
        assert cells["mpjpe"].details[GLOBAL] == pytest.approx(global_mm, abs=1e-3)
    if mre is not None:
        assert cells["mre"].value == pytest.approx(mre, rel=1e-3, abs=1e-3)
        assert cells["mre"].details[DISTANCE] == pytest.approx(mre * 263**0.5, rel=1e-3, abs=1e-2)


def test_windows_weigh_by_their_duration() -> None:
    short = window_errors(TRUTH + np.float32([0.03, 0.0, 0.04]), TRUTH, FPS, 1.0)
    long = window_errors(TRUTH[:30] + np.float32([0.0, 0.01, 0.0]), TRUTH[:30], FPS, 3.0)
    cell = error_cells([short, long])["mpjpe"]
    assert cell.details == {GLOBAL: pytest.approx((1 * 50.0 + 3 * 10.0) / 4, abs=1e-3), COUNT: 2.0}


@pytest.mark.parametrize("fps", [20, 60, 120])
def test_the_truth_at_a_lower_framerate_is_the_motion_itself(fps: int) -> None:
    source = analytic_source()
    windows = cut_windows(source, max_duration_seconds=4.0)
    truth = window_truth(source, windows, 0, Fraction(fps))
    assert len(truth) == 4 * fps + 1
    expected = analytic_positions(np.arange(4 * fps + 1) / fps, 0)[None]
    expected = field.to_window(expected, windows.yaw[:1], windows.origin[:1])[0]
    np.testing.assert_allclose(truth, expected, atol=2e-3)


def test_separate_windows_cover_without_overlap_or_mirror() -> None:
    source = analytic_source(seconds=10.0)
    windows = cut_windows(source, max_duration_seconds=3.0, stride_seconds=1.0, mirror_pairs=SMPL22.left_right_pairs)
    chosen = windows.select(separate_windows(windows))
    assert not chosen.mirrored.any()
    for sequence in range(4):
        mine = chosen.select(chosen.sequence_index == sequence)
        assert mine.start_seconds.tolist() == [0.0, 3.0, 6.0]
