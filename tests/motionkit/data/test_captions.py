"""Captions and actions of windows: which belong to a window, and what a mirror does to their words."""

import numpy as np
import pandas as pd
import pytest

from motionkit.data.captions import actions_of_windows, captions_of_windows, mirrored_text, overlapping_captions
from motionkit.data.windows import Windows


def caption(text, start=0.0, end=None):
    return {"text": text, "start_seconds": start, "end_seconds": end, "tokens": ""}


@pytest.fixture
def sequences() -> pd.DataFrame:
    return pd.DataFrame(
        {
            "captions": [
                np.array([caption("walks, then turns left", 0.0, 12.0), caption("turns left", 8.0, 12.0)]),
                np.array([], dtype=object),
                np.array([caption("jumps"), caption("a leap")]),
            ],
            "action": ["turn-left", "", "jump"],
        }
    )


def windows(*rows: tuple[int, int, int, int, bool]) -> Windows:
    """(sequence, first frame, frames, fps, mirrored) each."""
    sequence, start, frames, fps, mirrored = (np.array(column) for column in zip(*rows, strict=True))
    count = len(sequence)
    return Windows(
        max_duration_seconds=10.0,
        sequence_index=sequence.astype(np.int64),
        start_row=np.zeros(count, dtype=np.int64),
        start_frame=start.astype(np.int64),
        num_frames=frames.astype(np.int64),
        fps_numerator=fps.astype(np.int64),
        fps_denominator=np.ones(count, dtype=np.int64),
        mirrored=mirrored.astype(bool),
        yaw=np.zeros(count, dtype=np.float32),
        origin=np.zeros((count, 2), dtype=np.float32),
    )


def test_windows_get_their_segments_and_mirrored_words(sequences):
    cut = windows((0, 0, 300, 60, False), (0, 480, 240, 60, True), (1, 0, 60, 30, False), (2, 0, 30, 30, True))
    assert captions_of_windows(cut, sequences) == [
        ("walks, then turns left",),
        ("walks, then turns right", "turns right"),
        (),
        ("jumps", "a leap"),
    ]
    assert actions_of_windows(cut, sequences) == ["turn-left", "turn-right", "", "jump"]


def test_captions_of_a_window():
    spans = ((0.0, 20.0), (0.0, 4.0), (9.5, 14.0), (8.0, 12.0), (12.0, 20.0), (0.0, None), (9.0, None))
    rows = [caption(f"{start}-{end}", start, end) for start, end in spans]
    assert overlapping_captions(rows, 0.0, 10.0) == ("0.0-20.0", "0.0-4.0", "8.0-12.0", "0.0-None")
    assert overlapping_captions(rows, 9.0, 15.0)[-1] == "9.0-None"
    with pytest.raises(ValueError):
        overlapping_captions(rows, 3.0, 3.0)


@pytest.mark.parametrize(
    ("text", "seen_in_a_mirror"),
    [
        ("a person waves the left hand", "a person waves the right hand"),
        ("Left, then right; walk-turn-right", "Right, then left; walk-turn-left"),
        ("walks counter-clockwise around a bright cleft", "walks clockwise around a bright cleft"),
        ("turns counter clockwise, then anti-clockwise", "turns clockwise, then clockwise"),
        ("Anticlockwise, then clockwise", "Clockwise, then counterclockwise"),
        ("leftward, leftwards and to the leftmost", "rightward, rightwards and to the rightmost"),
        ("upright, alright, counters and lefties", "upright, alright, counters and lefties"),
    ],
)
def test_mirrored_text(text, seen_in_a_mirror):
    assert mirrored_text(text) == seen_in_a_mirror
