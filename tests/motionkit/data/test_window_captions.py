"""Which captions belong to a window, and what a mirror does to their words."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motionkit.data.captions import mirrored_text, overlapping_captions


def captions(*spans):
    return [{"text": f"{a}-{b}", "start_seconds": a, "end_seconds": b} for a, b in spans]


def test_captions_of_a_window():
    rows = captions((0.0, 20.0), (0.0, 4.0), (9.5, 14.0), (8.0, 12.0), (12.0, 20.0), (0.0, None), (9.0, None))
    assert overlapping_captions(rows, 0.0, 10.0) == ("0.0-20.0", "0.0-4.0", "8.0-12.0", "0.0-None")
    assert overlapping_captions(rows, 9.0, 15.0)[-1] == "9.0-None"
    with pytest.raises(ValueError, match="empty"):
        overlapping_captions(rows, 3.0, 3.0)


@given(
    start=st.floats(0, 50),
    length=st.floats(0.1, 20) | st.none(),
    window=st.floats(0, 50),
    duration=st.floats(0.1, 10),
)
def test_a_kept_caption_really_overlaps(start, length, window, duration):
    end = None if length is None else start + length
    if overlapping_captions(captions((start, end)), window, window + duration):
        assert start < window + duration
        assert end is None or window < end


@pytest.mark.parametrize(
    ("text", "seen_in_a_mirror"),
    [
        ("a person waves the left hand", "a person waves the right hand"),
        ("Left, then right; walk-turn-right", "Right, then left; walk-turn-left"),
        ("walks counter-clockwise around a bright cleft", "walks clockwise around a bright cleft"),
        ("turn_left clockwise", "turn_right counterclockwise"),
        ("turns counter clockwise, then anti-clockwise", "turns clockwise, then clockwise"),
        ("Anticlockwise, then clockwise", "Clockwise, then counterclockwise"),
        ("leftward, leftwards and to the leftmost", "rightward, rightwards and to the rightmost"),
        ("TURNS RIGHT", "TURNS LEFT"),
        ("upright, alright, counters and lefties", "upright, alright, counters and lefties"),
        ("jumps", "jumps"),
    ],
)
def test_mirrored_text(text, seen_in_a_mirror):
    assert mirrored_text(text) == seen_in_a_mirror


@given(
    st.lists(st.sampled_from(["left", "rightwards", "LEFTMOST", "clockwise", "counterclockwise", "walks", "bright"]))
)
def test_mirroring_twice_is_nothing(words):
    text = " ".join(words)
    assert mirrored_text(mirrored_text(text)) == text
