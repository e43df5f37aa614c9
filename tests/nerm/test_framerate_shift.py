"""How far a field moves between framerates, on fields whose shift is known."""

from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
import pytest

from motionkit.core.skeleton import SMPL22
from motionkit.fields.motion_field import Poses, check_times
from nerm.model import common_fps, framerate_shift


@dataclass(frozen=True, eq=False)
class Shifted:
    """All joints at (t, log₂(fps / 20) millimetres, 0)."""

    end_seconds: float = 2.0
    fps: Fraction = Fraction(120)
    start_seconds = 0.0
    skeleton = SMPL22

    def at_fps(self, fps):
        return replace(self, fps=fps)

    def query(self, times_seconds):
        check_times(self, times_seconds)
        positions = np.zeros((len(times_seconds), 22, 3), dtype=np.float32)
        positions[..., 0] = times_seconds[:, None]
        positions[..., 1] = 1e-3 * np.log2(float(self.fps) / 20.0)
        return Poses(positions)


def test_a_known_shift():
    found = framerate_shift([Shifted(), Shifted(1.0)], (Fraction(20), Fraction(40), Fraction(80)))
    assert found.max_mm == pytest.approx(2.0, rel=1e-4)
    assert found.mean_mm == pytest.approx((1 + 2 + 1) / 3, rel=1e-4)
    assert (found.num_motions, found.num_instants) == (2, 41 + 21)


def test_a_field_without_framerates_stays_where_it_is():
    class Still:
        start_seconds, end_seconds, skeleton = 0.0, 1.0, SMPL22

        def query(self, times_seconds):
            return Poses(np.zeros((len(times_seconds), 22, 3), dtype=np.float32))

    assert framerate_shift([Still()]).max_mm == 0.0


def test_instants_are_those_that_all_rates_share():
    rates = (Fraction(20), Fraction(30), Fraction(24000, 1001))
    shared = common_fps(rates)
    assert all((rate / shared).denominator == 1 for rate in rates)
    assert common_fps((Fraction(20), Fraction(30), Fraction(60), Fraction(120))) == 10


def test_one_framerate_is_no_comparison():
    with pytest.raises(ValueError, match="two framerates"):
        framerate_shift([Shifted()], (Fraction(20),))
    with pytest.raises(ValueError, match="needs a motion"):
        framerate_shift([])
