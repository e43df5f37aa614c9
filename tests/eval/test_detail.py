"""The detail profile: known answers of each figure, and what does not change them."""

from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest
import scipy.ndimage

from eval.clip_fid.score import ClipError
from eval.detail import RealDetail, detail_profile
from eval.sets.motions import low_pass
from eval.sets.sets import sample_set
from motionkit.core.errors import UsageError
from tests.helpers.stamping import stamping


@pytest.fixture(scope="module")
def real() -> RealDetail:
    return RealDetail.of(stamping(), stamping(seed=1))


def changed(real: RealDetail, change: Callable[[np.ndarray], np.ndarray]) -> dict[str, float]:
    takes = [change(take).astype(np.float32) for take in real.real.sequences]
    figures = real.profile(real.real.with_positions(takes)).figures
    return {name: figure.value for name, figure in figures.items()}


def test_real_motion_beside_itself_is_one_and_nought_and_within_its_own_range(real: RealDetail) -> None:
    profile = real.profile(real.real)
    assert profile.timing.value == 1.0
    assert [each.value for each in profile.energy_db.values()] == [0.0] * 4
    assert profile.rigidity_mm.value < 0.01
    assert all(figure.is_real for figure in profile.figures.values())
    assert 0.8 < real.real_slope < 1.6


def test_smooth_motion_has_neither_timing_nor_energy(real: RealDetail) -> None:
    found = changed(real, lambda take: low_pass(take, 120.0, 8.0))
    assert abs(found["T"]) < 0.1 and found["12–18 Hz"] < -6


def test_white_noise_has_energy_without_timing_and_changes_bones(real: RealDetail) -> None:
    rng = np.random.default_rng(0)
    found = changed(real, lambda take: low_pass(take, 120.0, 8.0) + 0.002 * rng.standard_normal(take.shape))
    assert abs(found["T"]) < 0.15 and found["27–40 Hz"] > 6
    # A bone's length has the noise of both of its ends along it, of which an 8 Hz high-pass leaves nearly all.
    assert found["R"] == pytest.approx(2.0 * np.sqrt(2.0), rel=0.15)


@pytest.mark.parametrize("gain", [0.5, 2.0])
def test_louder_fast_motion_has_as_much_more_energy(real: RealDetail, gain: float) -> None:
    def louder(take: np.ndarray) -> np.ndarray:
        slow = low_pass(take.astype(np.float64), 120.0, 9.0)
        return slow + gain * (take - slow)

    assert changed(real, louder)["18–27 Hz"] == pytest.approx(20 * np.log10(gain), abs=1.5)


def test_few_takes_have_no_range_and_slow_motion_no_profile() -> None:
    few = stamping(3)
    assert RealDetail.of(few, few).profile(few).timing.real_range is None
    slow = sample_set("slow", Fraction(30), [take[::4] for take in few.sequences], few.sequence_ids)
    with pytest.raises(UsageError):
        RealDetail.of(slow, slow)


def test_frozen_motion_has_no_timing_and_cannot_be_compared_with(real: RealDetail) -> None:
    frozen = real.real.with_positions([np.repeat(take[:1], 200, axis=0) for take in real.real.sequences])
    profile = real.profile(frozen)
    assert profile.timing.value == 0.0 and not profile.timing.is_real
    with pytest.raises(ClipError):
        RealDetail.of(frozen, real.real)
    with pytest.raises(ClipError):
        RealDetail.of(frozen, frozen)


def test_arrays_of_anybody_have_a_profile() -> None:
    walks = list(stamping().sequences)
    smooth = [scipy.ndimage.gaussian_filter1d(walk, 4, axis=0) for walk in walks]
    profile = detail_profile(walks, smooth, fps=120)
    assert profile.timing.interval[0] <= profile.timing.value <= profile.timing.interval[1]
    assert profile.energy_db[12.0, 18.0].value < -6 and "outside" in str(profile)
