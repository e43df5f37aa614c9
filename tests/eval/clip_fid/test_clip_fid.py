"""clip-fid/1: the clip list, where clips fall, what a copy and a change score."""

from fractions import Fraction

import numpy as np
import pytest

from eval.clip_fid.clips import (
    OTHER,
    REAL,
    ClipError,
    PoseRange,
    Protocol,
    SecondsRange,
    check_lengths,
    describe_clips,
    draw_clips,
    place_clips,
)
from eval.clip_fid.score import score_disjoint_halves, score_rows
from eval.sets.sets import SampleSet, sample_set

FPS = Fraction(60)
SMALL = Protocol(num_clips=400, replications=3, detailed_replications=1)


class FirstAndLastHeight:
    """A feature set that a person can check: root height of the first and of the last pose, and the clip's size."""

    name = "heights"
    fingerprint = "heights/1"

    def describe(self, clips: np.ndarray, fps: Fraction) -> np.ndarray:
        size = np.full(len(clips), clips.shape[1] / 100)
        return np.stack((clips[:, 0, 0, 1], clips[:, -1, 0, 1], size), axis=1).astype(np.float64)


def ramps(name: str, lengths: list[int], offset: float = 0.0, fps: Fraction = FPS) -> SampleSet:
    """Sequences whose root height tells sequence and frame: 1000 · sequence + frame."""
    sequences = []
    for index, length in enumerate(lengths):
        positions = np.zeros((length, 22, 3), dtype=np.float32)
        positions[:, 0, 1] = 1000 * index + np.arange(length) + offset
        sequences.append(positions)
    return sample_set(name, fps, sequences, [f"{name}-{i}" for i in range(len(lengths))])


def test_both_sides_share_sizes_and_centres_but_not_sequences() -> None:
    real, other = (draw_clips(SMALL, FPS, 0, side) for side in (REAL, OTHER))
    np.testing.assert_array_equal(real.num_poses, other.num_poses)
    np.testing.assert_array_equal(real.centre_quantile, other.centre_quantile)
    assert not np.array_equal(real.sequence_quantile, other.sequence_quantile)
    again = draw_clips(SMALL, FPS, 0, REAL)
    np.testing.assert_array_equal(real.sequence_quantile, again.sequence_quantile)
    for changed in (draw_clips(SMALL, FPS, 1, REAL), draw_clips(SMALL, Fraction(20), 0, REAL)):
        assert not np.array_equal(real.centre_quantile, changed.centre_quantile)
    assert set(np.unique(real.num_poses)) == set(range(16, 65, 4))


def test_clips_lie_inside_their_sequence_and_reach_both_ends() -> None:
    samples = ramps("ramps", [64, 100, 3, 300])
    protocol = Protocol(num_clips=60_000)
    places = place_clips(draw_clips(protocol, FPS, 0, REAL), samples)
    start = places.first_row - samples.sequences.start_row[places.sequence]
    assert (start >= 0).all()
    assert (start + places.num_poses <= samples.sequences.num_frames[places.sequence]).all()
    assert 2 not in places.sequence
    short = (places.sequence == 1) & (places.num_poses == 16)
    assert (start[short].min(), start[short].max()) == (0, 84)
    assert np.bincount(start[short], minlength=85).min() > 0


def test_features_come_in_the_order_of_the_places() -> None:
    samples = ramps("ramps", [80, 90])
    places = place_clips(draw_clips(SMALL, FPS, 0, REAL), samples)
    described = describe_clips(samples, places, FirstAndLastHeight())
    np.testing.assert_array_equal(described[:, 0], samples.sequences.values[places.first_row, 0, 1])
    np.testing.assert_array_equal(described[:, 1] - described[:, 0], places.num_poses - 1)


def test_too_short_sequences_are_refused_with_the_reason() -> None:
    samples = ramps("tiny", [40, 30])
    with pytest.raises(ClipError, match=r"tiny: no sequence has the 64 poses .* the longest has 40"):
        check_lengths(samples, SMALL)
    with pytest.raises(ClipError, match=r"tiny: no sequence among 2 has \d+ poses"):
        place_clips(draw_clips(SMALL, FPS, 0, REAL), samples)
    places = place_clips(draw_clips(Protocol(sizes=PoseRange(16, 40)), FPS, 0, REAL), samples)
    assert places.num_poses.max() == 40


def test_clip_sizes_in_seconds_grow_with_the_framerate() -> None:
    sizes = SecondsRange(0.4, 1.6)
    assert sizes.sizes(Fraction(20)).tolist() == list(range(8, 33, 4))
    assert sizes.sizes(Fraction(120)).tolist() == list(range(48, 193, 4))
    with pytest.raises(ClipError, match="no multiple of 4 poses"):
        SecondsRange(0.41, 0.42).sizes(Fraction(20))
    assert PoseRange(10, 25, 4).sizes(FPS).tolist() == [12, 16, 20, 24]


def test_a_copy_scores_the_floor_and_a_change_scores_more() -> None:
    real = ramps("real", [200] * 40)
    rows = {"copy": real, "moved": ramps("moved", [200] * 40, offset=8000.0)}
    scores = score_rows(real, rows, FirstAndLastHeight(), SMALL)
    assert 0 < scores["copy"].value < 0.05 * scores["moved"].value
    assert scores["copy"].details["coverage"] > 0.9


def test_disjoint_halves_score_more_than_independent_draws() -> None:
    rng = np.random.default_rng(0)
    heights = rng.normal(size=12)
    sequences = [np.full((100, 22, 3), height, dtype=np.float32) for height in heights]
    real = sample_set("real", FPS, sequences, [str(i) for i in range(12)])
    independent = score_rows(real, {"P1": real}, FirstAndLastHeight(), SMALL)["P1"]
    halves = score_disjoint_halves(real, FirstAndLastHeight(), SMALL)
    assert halves.value > 5 * independent.value
    with pytest.raises(ClipError, match="cannot be split"):
        score_disjoint_halves(real.select([0]), FirstAndLastHeight(), SMALL)
