"""The largest part of a capture without long gaps, against a search through all of them."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from motionkit.io.markers import largest_block


def longest_gap(missing: np.ndarray) -> int:
    gaps = "".join("x" if gone else " " for gone in missing).split()
    return max(map(len, gaps), default=0)


def visible(column: np.ndarray, max_gap: int) -> np.ndarray:
    """Frames of one marker that are seen or lie in a short gap, found one after the other."""
    shown = np.ones(len(column), bool)
    start = None
    for frame, gone in enumerate([*column.tolist(), False]):
        if gone and start is None:
            start = frame
        if not gone and start is not None:
            if frame - start > max_gap or column.all():
                shown[start:frame] = False
            start = None
    return shown


@settings(max_examples=150)
@given(
    missing=arrays(bool, st.tuples(st.integers(1, 12), st.integers(1, 5)), elements=st.booleans()),
    max_gap=st.integers(0, 3),
)
def test_no_other_block_holds_more(missing: np.ndarray, max_gap: int) -> None:
    shown = np.stack([visible(column, max_gap) for column in missing.T], axis=1)
    best = max(
        (stop - start) * int(shown[start:stop].all(axis=0).sum())
        for start in range(len(missing))
        for stop in range(start + 1, len(missing) + 1)
    )
    block = largest_block(missing, max_gap)
    assert (block.stop - block.start) * int(block.markers.sum()) == best
    assert shown[block.start : block.stop, block.markers].all()
    for marker in np.flatnonzero(block.markers):
        assert longest_gap(missing[block.start : block.stop, marker]) <= max_gap
        assert not missing[:, marker].all()


def test_long_takes_lose_at_most_a_step_of_the_grid() -> None:
    missing = np.zeros((100_000, 60), bool)
    missing[:12_345, 10:] = True
    missing[99_000:, 10:20] = True
    block = largest_block(missing, 12)
    assert (block.start, block.stop, int(block.markers.sum())) == (12_345, 99_000, 60)
