"""Errors of reconstructions whose errors are known; Table 4 as a whole: tests/nerm/test_stages.py."""

from fractions import Fraction

import numpy as np
import pytest

from eval.reconstruction import COUNT, DISTANCE, GLOBAL, Reconstruction, mpjpe_cell, mre_cell, window_errors
from tests.helpers.nerm_corpus import analytic_positions

FPS = Fraction(60)
TRUTH = analytic_positions(np.arange(90) / 60, 1)


def test_windows_weigh_by_their_duration_and_a_root_s_error_is_global_alone() -> None:
    short = Reconstruction(TRUTH + np.float32([0.03, 0.0, 0.04]), TRUTH, seconds=1.0)
    long = Reconstruction(TRUTH[:30] + np.float32([0.0, 0.01, 0.0]), TRUTH[:30], seconds=3.0)
    cell = mpjpe_cell([window_errors(window, FPS) for window in (short, long)])
    assert cell is not None
    assert cell.value == pytest.approx(0.0, abs=1e-3)
    assert cell.details == {GLOBAL: pytest.approx((1 * 50.0 + 3 * 10.0) / 4, abs=1e-3), COUNT: 2.0}


def test_one_joint_s_error_counts_for_one_joint_in_22() -> None:
    found = TRUTH.copy()
    found[:, 7, 1] += 0.022
    cell = mpjpe_cell([window_errors(Reconstruction(found, TRUTH, seconds=2.0), FPS)])
    assert cell is not None
    assert (cell.value, cell.details[GLOBAL]) == (pytest.approx(1.0, abs=1e-3), pytest.approx(1.0, abs=1e-3))


def test_mre_of_a_body_that_is_too_high_is_that_of_its_heights() -> None:
    found = TRUTH + np.float32([0.0, 0.05, 0.0])
    cell = mre_cell([window_errors(Reconstruction(found, TRUTH, seconds=2.0), FPS)])
    assert cell is not None
    # 22 of the 263 numbers are heights: the root's and those of the other 21 joints.
    assert cell.value == pytest.approx(0.05 * (22 / 263) ** 0.5, rel=1e-3)
    assert cell.details == {DISTANCE: pytest.approx(0.05 * 22**0.5, rel=1e-3)}


def test_mre_does_not_see_where_a_motion_is_or_which_way_it_faces() -> None:
    turned = TRUTH[..., [2, 1, 0]] * np.float32([1, 1, -1]) + np.float32([3.0, 0.0, -2.0])
    cell = mre_cell([window_errors(Reconstruction(turned, TRUTH, seconds=2.0), FPS)])
    assert cell is not None
    assert cell.value < 1e-3


def test_no_window_is_no_number() -> None:
    assert mpjpe_cell([]) is None
    assert mre_cell([]) is None
