"""What a store's table says of windows."""

import numpy as np
import pandas as pd
import pytest

from motionkit.data.captions import actions_of_windows, captions_of_windows
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
