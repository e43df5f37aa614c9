"""Table 4's errors on reconstructions whose errors are known; the whole table is built in tests/nerm/test_stages.py."""

import numpy as np
import pytest

from eval.tables.table4 import COUNT, GLOBAL, error_cell
from nerm.reconstruction import Reconstruction

TRUTH = np.random.default_rng(0).normal(size=(5, 22, 3)).astype(np.float32)


def test_windows_weigh_by_their_duration_and_a_root_s_error_is_global_alone() -> None:
    short = Reconstruction(TRUTH + np.float32([0.03, 0.0, 0.04]), TRUTH, seconds=1.0)
    long = Reconstruction(TRUTH[:3] + np.float32([0.0, 0.01, 0.0]), TRUTH[:3], seconds=3.0)
    cell = error_cell(iter([short, long]))
    assert cell is not None
    assert cell.value == pytest.approx(0.0, abs=1e-3)
    assert cell.details == {GLOBAL: pytest.approx((1 * 50.0 + 3 * 10.0) / 4, abs=1e-3), COUNT: 2.0}


def test_one_joint_s_error_counts_for_one_joint_in_22() -> None:
    found = TRUTH.copy()
    found[:, 7, 1] += 0.022
    cell = error_cell([Reconstruction(found, TRUTH, seconds=2.0)])
    assert cell is not None
    assert (cell.value, cell.details[GLOBAL]) == (pytest.approx(1.0, abs=1e-3), pytest.approx(1.0, abs=1e-3))


def test_no_window_is_no_number() -> None:
    assert error_cell([]) is None
