from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motionkit.core.timegrid import TimeGrid, num_frames_within, parse_fps


@pytest.mark.parametrize(
    ("value", "fps"),
    [
        (120.00004577636719, Fraction(120)),
        ("59.9999885", Fraction(60)),
        ("59.94", Fraction(60000, 1001)),
        ("30000/1001", Fraction(30000, 1001)),
        (1 / 0.0083333, Fraction(120)),
        (1 / 0.0333333, Fraction(30)),
        (12.5, Fraction(25, 2)),
        (90, Fraction(90)),
    ],
)
def test_framerates_are_read_exactly(value: object, fps: Fraction) -> None:
    assert parse_fps(value) == fps  # type: ignore[arg-type]


@pytest.mark.parametrize("value", [0, -1, float("nan"), float("inf"), 1e9, "0", "fast", "1/0", "30/x", ""])
def test_impossible_framerates_are_refused(value: object) -> None:
    with pytest.raises(ValueError):
        parse_fps(value)  # type: ignore[arg-type]


def test_time_stamps_do_not_drift() -> None:
    seconds = TimeGrid(Fraction(30000, 1001), 1_000_000).seconds()
    assert seconds[-1] == pytest.approx(999_999 * 1001 / 30000, abs=1e-9)


@given(fps=st.sampled_from([20, 24, 30, 60, 120, 250]), num_frames=st.integers(1, 3000))
def test_frames_within_a_grid_are_its_own(fps: int, num_frames: int) -> None:
    grid = TimeGrid(Fraction(fps), num_frames)
    assert num_frames_within(grid.span_seconds, grid.fps) == num_frames
