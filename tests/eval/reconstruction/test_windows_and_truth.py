from fractions import Fraction

import numpy as np
import pytest

from eval.reconstruction import comparable, separate_windows, window_truth
from motionkit.core.skeleton import SMPL22
from motionkit.data.windows import cut_windows
from motionkit.features import field
from tests.helpers.nerm_corpus import analytic_positions, analytic_source

PAIRS = SMPL22.left_right_pairs


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
    windows = cut_windows(source, max_duration_seconds=3.0, stride_seconds=1.0, mirror_pairs=PAIRS)
    chosen = windows.select(separate_windows(windows))
    assert not chosen.mirrored.any()
    for sequence in range(4):
        mine = chosen.select(chosen.sequence_index == sequence)
        assert mine.start_seconds.tolist() == [0.0, 3.0, 6.0]


def test_comparable_windows_have_a_truth_at_every_framerate() -> None:
    windows = cut_windows(analytic_source(), max_duration_seconds=4.0)
    assert comparable(windows, [Fraction(20), Fraction(60)]).tolist() == [True, True, False, True]
