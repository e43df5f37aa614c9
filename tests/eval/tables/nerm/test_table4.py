"""Errors of reconstructions whose errors are known; Table 4 as a whole: tests/nerm/test_stages.py."""

from fractions import Fraction

import numpy as np
import pytest

from eval.tables.nerm.table4 import (
    COUNT,
    DISTANCE,
    GLOBAL,
    comparable,
    mpjpe_cell,
    mre_cell,
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


def test_windows_weigh_by_their_duration_and_a_root_s_error_is_global_alone() -> None:
    short = window_errors(TRUTH + np.float32([0.03, 0.0, 0.04]), TRUTH, FPS, 1.0)
    long = window_errors(TRUTH[:30] + np.float32([0.0, 0.01, 0.0]), TRUTH[:30], FPS, 3.0)
    cell = mpjpe_cell([short, long])
    assert cell.value == pytest.approx(0.0, abs=1e-3)
    assert cell.details == {GLOBAL: pytest.approx((1 * 50.0 + 3 * 10.0) / 4, abs=1e-3), COUNT: 2.0}


def test_one_joint_s_error_counts_for_one_joint_in_22() -> None:
    found = TRUTH.copy()
    found[:, 7, 1] += 0.022
    cell = mpjpe_cell([window_errors(found, TRUTH, FPS, 2.0)])
    assert (cell.value, cell.details[GLOBAL]) == (pytest.approx(1.0, abs=1e-3), pytest.approx(1.0, abs=1e-3))


def test_mre_of_a_body_that_is_too_high_is_that_of_its_heights() -> None:
    found = TRUTH + np.float32([0.0, 0.05, 0.0])
    cell = mre_cell([window_errors(found, TRUTH, FPS, 2.0)])
    # 22 of the 263 numbers are heights: the root's and those of the other 21 joints.
    assert cell.value == pytest.approx(0.05 * (22 / 263) ** 0.5, rel=1e-3)
    assert cell.details == {DISTANCE: pytest.approx(0.05 * 22**0.5, rel=1e-3)}


def test_mre_does_not_see_where_a_motion_is_or_which_way_it_faces() -> None:
    turned = TRUTH[..., [2, 1, 0]] * np.float32([1, 1, -1]) + np.float32([3.0, 0.0, -2.0])
    cell = mre_cell([window_errors(turned, TRUTH, FPS, 2.0)])
    assert cell.value < 1e-3


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


def test_comparable_windows_have_a_truth_at_every_framerate() -> None:
    windows = cut_windows(analytic_source(), max_duration_seconds=4.0)
    assert comparable(windows, [Fraction(20), Fraction(60)]).tolist() == [True, True, False, True]
