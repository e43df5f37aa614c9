"""What is to be completed: framerates, frames to keep, reaches; and the lines that say what is wrong with them."""

from fractions import Fraction

import numpy as np
import pytest

from motionkit.core.errors import MotionkitError, UsageError
from motionkit.edit.complete import CompletionRequest, Reach, kept_frames, parse_extend, parse_keep
from motionkit.edit.motions import LoadedMotion
from tests.helpers.turning_body import random_motion


def test_ranges_of_frames() -> None:
    assert parse_keep("0:10,40:50") == ((0, 10), (40, 50))
    assert parse_keep("40:, :10 ,25") == ((40, None), (0, 10), (25, 26))
    assert np.flatnonzero(kept_frames(parse_keep(":2,4,6:"), 8)).tolist() == [0, 1, 4, 6, 7]
    assert kept_frames(None, 3).all()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not a range"),
        ("a:b", "'a:b'"),
        ("-3:5", "'-3:5'"),
        ("0:10,,20:30", "''"),
        ("10:10", "no frame"),
        ("10:5", "no frame"),
        ("0:10,5:20", "overlap"),
        ("40:,50:60", "overlap"),
        ("3,3", "overlap"),
        ("9" * 5000, "not a range"),
        (f"0:{'9' * 5000}", "not a range"),
    ],
)
def test_invalid_ranges(text: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        parse_keep(text)


@pytest.mark.parametrize("text", ["5:30", "20:", "19:21", "500:501"])
def test_ranges_outside_the_clip_name_its_frames(text: str) -> None:
    with pytest.raises(MotionkitError, match=r"inside its 20 frames, 0:20"):
        kept_frames(parse_keep(text), 20)


def test_reaches() -> None:
    assert parse_extend("0.5,1") == (Reach(0.5), Reach(1.0))
    assert parse_extend("2") == (Reach(0.0), Reach(2.0))
    before, after = parse_extend("0,15f")
    assert before.seconds(Fraction(30)) == 0.0 and after.seconds(Fraction(30)) == 0.5
    for text in ("", "a", "-1", "1,2,3", "nan", "inf", "1.5f", "0,"):
        with pytest.raises(UsageError, match="extend"):
            parse_extend(text)


def test_a_request_for_one_motion() -> None:
    motion = random_motion(0)
    loaded, one = LoadedMotion.of(motion), LoadedMotion.of(motion.frames(0, 1))
    completion = CompletionRequest(keep=parse_keep("0:5,12:")).of(loaded)
    assert completion.fps == 30 and completion.longest_gap_seconds == pytest.approx(8 / 30)
    with pytest.raises(UsageError, match="nothing to complete"):
        CompletionRequest()
    with pytest.raises(MotionkitError, match=r"24 fps is less than its 30.*convert --fps 24"):
        CompletionRequest(fps=Fraction(24)).of(loaded)
    with pytest.raises(MotionkitError, match="single frame"):
        CompletionRequest(fps=Fraction(60)).of(one)
    with pytest.raises(MotionkitError, match="61 s"):
        CompletionRequest(after=Reach(61.0)).of(loaded)
    lost = LoadedMotion(motion, np.arange(20) > 4)
    with pytest.raises(MotionkitError, match="nan"):
        CompletionRequest(keep=parse_keep(":5")).of(lost)
    assert CompletionRequest(fps=Fraction(60)).of(lost).observed.sum() == 15


def test_uneven_times_need_a_framerate_and_have_their_own_gaps() -> None:
    seconds = np.concatenate((np.arange(10) / 30, 0.5 + np.arange(10) / 30))
    loaded = LoadedMotion(random_motion(0), np.ones(20, bool), seconds)
    with pytest.raises(MotionkitError, match="uneven in time"):
        CompletionRequest(after=Reach(1.0)).of(loaded)
    assert CompletionRequest(fps=Fraction(60)).of(loaded).longest_gap_seconds == pytest.approx(0.5 - 9 / 30)
