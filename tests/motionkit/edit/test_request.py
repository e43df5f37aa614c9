"""What is to be completed: framerates, frames to keep, reaches; and the lines that say what is wrong with them."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from motionkit.core.errors import MotionkitError, UsageError
from motionkit.edit.complete import (
    CompletedMotion,
    CompletionRequest,
    Reach,
    completed_motion,
    kept_frames,
    parse_extend,
    parse_keep,
)
from motionkit.edit.encoders import choose_encoder
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
    assert parse_extend("0,15f") == (Reach(0.0), Reach(15.0, in_frames=True))
    for text in ("", "a", "-1", "1,2,3", "nan", "inf", "1.5f", "0,"):
        with pytest.raises(UsageError, match="extend"):
            parse_extend(text)


def completed(loaded: LoadedMotion, request: CompletionRequest) -> CompletedMotion:
    return completed_motion(loaded, request, choose_encoder("slerp", None, Path("runs")))


def test_a_request_for_one_motion() -> None:
    motion = random_motion(0)
    loaded, one = LoadedMotion.of(motion), LoadedMotion.of(motion.frames(0, 1))
    made = completed(loaded, CompletionRequest(keep=parse_keep("0:5,12:")))
    assert made.edited.motion.fps == 30 and made.longest_gap_seconds == pytest.approx(8 / 30)
    assert completed(loaded, CompletionRequest(after=Reach(15.0, in_frames=True))).edited.motion.num_frames == 35
    with pytest.raises(UsageError, match="nothing to complete"):
        CompletionRequest()
    lost = LoadedMotion(motion, np.arange(20) > 4)
    assert completed(lost, CompletionRequest(fps=Fraction(60))).edited.observed.sum() == 15
    for case, request, message in (
        (loaded, CompletionRequest(fps=Fraction(24)), r"24 fps is less than its 30.*convert --fps 24"),
        (one, CompletionRequest(fps=Fraction(60)), "single frame"),
        (loaded, CompletionRequest(after=Reach(61.0)), "61 s"),
        (lost, CompletionRequest(keep=parse_keep(":5")), "nan"),
    ):
        with pytest.raises(MotionkitError, match=message):
            completed(case, request)


def test_uneven_times_need_a_framerate_and_have_their_own_gaps() -> None:
    seconds = np.concatenate((np.arange(10) / 30, 0.5 + np.arange(10) / 30))
    loaded = LoadedMotion(random_motion(0), np.ones(20, bool), seconds)
    with pytest.raises(MotionkitError, match="uneven in time"):
        completed(loaded, CompletionRequest(after=Reach(1.0)))
    made = completed(loaded, CompletionRequest(fps=Fraction(60)))
    assert made.longest_gap_seconds == pytest.approx(0.5 - 9 / 30)
