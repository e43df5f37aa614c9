"""Windows of sequences, what is said of them, and batches."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import motionkit as mk
from motionkit.core.motion import mirror_positions
from motionkit.core.skeletons.mapping import rest_positions
from motionkit.data.captions import actions_of_windows, captions_of_windows, mirrored_text, overlapping_captions
from motionkit.data.windows import FrameValues, WindowPoses, Windows, cut_windows, rows_by_duration, shuffled_batches
from motionkit.features import field
from motionkit.features.field import FIELD_VECTORS
from motionkit.store.cache import PositionCache
from tests.helpers.nerm_corpus import corpus_in_memory

PAIRS = mk.SMPL22.left_right_pairs


def make_source(frames: list[int], rates: list[Fraction], seed: int = 0) -> PositionCache:
    """Random bodies: a rest pose, jittered, walking along a line at 1 m/s."""
    rng = np.random.default_rng(seed)
    sequences = []
    for count, fps in zip(frames, rates, strict=True):
        path = np.arange(count)[:, None, None] / float(fps) * np.array([0.6, 0.0, 0.8])
        sequences.append(rest_positions(mk.SMPL22) + path + rng.normal(0, 0.02, (count, 22, 3)) + [3.0, 1.0, -2.0])
    return replace(corpus_in_memory(sequences, rates), sequence_index=np.arange(len(frames), dtype=np.int32) + 10)


@pytest.fixture(scope="module")
def source() -> PositionCache:
    return make_source(
        [241, 1500, 90, 5, 400], [Fraction(120), Fraction(120), Fraction(30), Fraction(60), Fraction(24)]
    )


@settings(max_examples=25)
@given(
    frames=st.lists(st.integers(2, 900), min_size=1, max_size=4),
    rate=st.sampled_from([Fraction(20), Fraction(30000, 1001), Fraction(120), Fraction(250)]),
    longest=st.floats(0.7, 12.0),
    stride=st.floats(0.2, 12.0),
)
def test_windows_cover_their_sequences_and_never_leave_them(frames, rate, longest, stride):
    source = make_source(frames, [rate] * len(frames))
    kept = [index for index, count in enumerate(frames) if (count - 1) / float(rate) >= 0.5]
    if not kept:
        with pytest.raises(mk.UsageError):
            cut_windows(source, max_duration_seconds=longest, stride_seconds=min(stride, longest))
        return
    windows = cut_windows(source, max_duration_seconds=longest, stride_seconds=min(stride, longest))
    assert windows.duration_seconds.max() <= longest + 1e-6
    for index in kept:
        mine = windows.select(windows.sequence_index == index + 10)
        covered = np.zeros(frames[index], dtype=int)
        for start, count in zip(mine.start_frame, mine.num_frames, strict=True):
            assert start >= 0
            assert start + count <= frames[index]
            covered[start : start + count] += 1
        assert (covered > 0).all()


def test_a_window_of_l_max_spans_the_whole_domain(source: PositionCache) -> None:
    windows = cut_windows(source, max_duration_seconds=10.0)
    poses = WindowPoses(windows, FrameValues(source.positions, FIELD_VECTORS))
    long = int(np.argmax(windows.num_frames))
    assert windows.num_frames[long] == 1201
    batch = poses.at_frames(np.array([long]), np.array([[0, 600, 1200]]))
    assert batch.coordinates.tolist() == [[-1.0, 0.0, 1.0]]
    assert batch.fps.tolist() == [120.0]


def test_vectors_are_those_of_the_window_s_frame(source: PositionCache) -> None:
    windows = cut_windows(source, max_duration_seconds=4.0, stride_seconds=1.0, mirror_pairs=PAIRS)
    poses = WindowPoses(windows, FrameValues(source.positions, FIELD_VECTORS))
    rows = np.arange(len(windows))
    first = field.decode(poses.at_frames(rows, np.zeros((len(rows), 1), dtype=np.int64)).vectors)[:, 0]
    np.testing.assert_allclose(first[:, 0, (0, 2)], 0.0, atol=1e-5)
    np.testing.assert_allclose(field.heading(first), 0.0, atol=1e-5)
    row = 3
    start = windows.start_row[row]
    world = source.positions[start : start + 5][None]
    expected = field.encode(world, windows.yaw[row : row + 1], windows.origin[row : row + 1])
    np.testing.assert_array_equal(poses.at_frames(np.array([row]), np.arange(5)[None]).vectors, expected)


def test_mirrored_windows_follow_their_originals(source: PositionCache) -> None:
    windows = cut_windows(source, max_duration_seconds=4.0, mirror_pairs=PAIRS)
    half = len(windows) // 2
    assert windows.mirrored.tolist() == [False] * half + [True] * half
    row = windows.start_row[[1, 1 + half], None] + np.array([0, 7])
    original, mirrored = FrameValues(source.positions, FIELD_VECTORS).gather(row, windows.mirrored[[1, 1 + half]])
    np.testing.assert_array_equal(mirror_positions(mirrored, PAIRS), original)
    assert mirrored[0, 1, 0] == -original[0, 2, 0]


def test_a_fixed_rate_hits_native_frames_where_it_can_and_interpolates_elsewhere(source: PositionCache) -> None:
    poses = WindowPoses(cut_windows(source, max_duration_seconds=10.0), FrameValues(source.positions, FIELD_VECTORS))
    fast = poses.at_rate(np.array([0]), np.arange(5)[None], Fraction(20))
    native = poses.at_frames(np.array([0]), 6 * np.arange(5)[None])
    np.testing.assert_allclose(fast.vectors, native.vectors, rtol=1e-6)
    np.testing.assert_allclose(fast.coordinates, native.coordinates)
    assert fast.fps.tolist() == [20.0]
    thirty = int(np.flatnonzero(poses.windows.fps == 30)[0])
    between = poses.at_rate(np.array([thirty]), np.array([[1]]), Fraction(20)).vectors
    neighbours = poses.at_frames(np.array([thirty]), np.array([[1, 2]])).vectors
    np.testing.assert_allclose(between, neighbours.mean(axis=1, keepdims=True), atol=1e-6)


@pytest.mark.parametrize("contiguous", [True, False])
@pytest.mark.parametrize("fps", [None, Fraction(20)])
def test_draws_stay_inside_and_depend_on_the_generator_alone(source, contiguous, fps):
    windows = cut_windows(source, max_duration_seconds=10.0)
    poses = WindowPoses(windows, FrameValues(source.positions, FIELD_VECTORS))
    rows = np.tile(np.arange(len(windows)), 20)

    def draw() -> np.ndarray:
        uniform = np.random.default_rng(1).random
        return poses.draw(rows, 16, lambda *shape: uniform(shape), contiguous=contiguous, fps=fps).coordinates

    coordinates = draw()
    np.testing.assert_array_equal(coordinates, draw())
    seconds = (coordinates + 1) * 5
    assert (seconds <= windows.duration_seconds[rows][:, None] + 1e-6).all()
    steps = np.diff(seconds, axis=1)
    if contiguous:
        rate = windows.fps[rows][:, None] if fps is None else float(fps)
        np.testing.assert_allclose(steps, np.broadcast_to(1.0 / rate, steps.shape), atol=1e-9)
    else:
        assert (steps < 0).any()


def test_random_framerates_are_whole_fractions_of_the_native_one(source: PositionCache) -> None:
    windows = cut_windows(source, max_duration_seconds=10.0)
    poses = WindowPoses(windows, FrameValues(source.positions, FIELD_VECTORS))
    uniform = np.random.default_rng(2).random
    batch = poses.draw(np.zeros(200, np.int64), 3, lambda *shape: uniform(shape), contiguous=False, lowest_fps=20.0)
    assert set(batch.fps.tolist()) == {120.0, 60.0, 40.0, 30.0, 24.0, 20.0}
    ticks = (batch.coordinates + 1) * 5 * batch.fps[:, None]
    np.testing.assert_allclose(ticks, ticks.round(), atol=1e-6)


def test_windows_are_visited_by_their_duration(source: PositionCache) -> None:
    windows = cut_windows(source, max_duration_seconds=10.0)
    visits = np.bincount(rows_by_duration(windows, 2.0), minlength=len(windows))
    assert visits.tolist() == np.maximum(1, np.round(windows.duration_seconds / 2.0)).tolist()


@settings(max_examples=50)
@given(count=st.integers(1, 50), batch=st.integers(1, 70), seed=st.integers(0, 5))
def test_batches_go_through_all_rows_before_any_comes_back(count: int, batch: int, seed: int) -> None:
    num_batches = -(-3 * count // batch)
    stream = np.concatenate([shuffled_batches(count, batch, step, seed) for step in range(num_batches)])[: 3 * count]
    for epoch in stream.reshape(3, count):
        assert sorted(epoch.tolist()) == list(range(count))


def test_batches_are_the_same_in_every_version() -> None:
    # A resumed training goes on with them.
    drawn = np.concatenate([shuffled_batches(5, 3, step, 7) for step in range(4)])
    assert drawn.tolist() == [1, 4, 3, 2, 0, 3, 4, 0, 1, 2, 4, 3]
    assert shuffled_batches(3, 8, 1, 7).tolist() == [1, 2, 1, 0, 2, 1, 0, 1]


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
