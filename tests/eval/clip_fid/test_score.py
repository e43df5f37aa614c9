"""clip-FID: where clips fall, what a copy and a change score, and the same number of motions in memory."""

from fractions import Fraction

import numpy as np
import pytest

import motionkit as mk
from eval import clip_fid
from eval.clip_fid import score
from eval.clip_fid.score import (
    KINEMATIC,
    OTHER,
    REAL,
    ClipError,
    Comparison,
    Protocol,
    describer,
    draw_clips,
)
from eval.sets.sets import SampleSet, sample_set
from motionkit.fields.motion_field import to_motion
from tests.helpers.analytic import ACTIONS, analytic_motion

FPS = Fraction(60)
SMALL = Protocol(num_clips=400, replications=3, detailed_replications=1)
# The same definition on fewer clips; the descriptor's fit on all of its 8,192 takes seconds.
FEW = {"clips": 256, "replications": 3}


class FirstAndLastHeight:
    """A feature set that a person can check: root height of the first and of the last pose, and the clip's size."""

    name = "heights"
    fingerprint = "heights/1"

    def describe(self, clips: np.ndarray, fps: Fraction) -> np.ndarray:
        size = np.full(len(clips), clips.shape[1] / 100)
        return np.stack((clips[:, 0, 0, 1], clips[:, -1, 0, 1], size), axis=1).astype(np.float64)


def ramps(name: str, lengths: list[int], offset: float = 0.0, fps: Fraction = FPS) -> SampleSet:
    """Sequences whose root height says which sequence and frame it is: 1000 · sequence + frame."""
    sequences = []
    for index, length in enumerate(lengths):
        positions = np.zeros((length, 22, 3), dtype=np.float32)
        positions[:, 0, 1] = 1000 * index + np.arange(length) + offset
        sequences.append(positions)
    return sample_set(name, fps, sequences, [f"{name}-{i}" for i in range(len(lengths))])


def test_both_sides_share_sizes_and_centres_but_not_sequences() -> None:
    samples = ramps("ramps", [200] * 10)
    real, other, again = (draw_clips(samples, SMALL, 0, side) for side in (REAL, OTHER, REAL))
    np.testing.assert_array_equal(real.first_row, again.first_row)
    np.testing.assert_array_equal(real.num_poses, other.num_poses)
    assert not np.array_equal(real.sequence, other.sequence)
    starts = [clips.first_row - samples.sequences.start_row[clips.sequence] for clips in (real, other)]
    np.testing.assert_array_equal(*starts)
    slower = ramps("slower", [200] * 10, fps=Fraction(20))
    for changed in (draw_clips(samples, SMALL, 1, REAL), draw_clips(slower, SMALL, 0, REAL)):
        assert not np.array_equal(real.first_row, changed.first_row)
    assert set(np.unique(real.num_poses)) == set(range(16, 65, 4))
    assert Protocol(10, 25).sizes.tolist() == [12, 16, 20, 24]


def test_clips_lie_inside_their_sequence_and_reach_both_ends() -> None:
    samples = ramps("ramps", [64, 100, 3, 300])
    clips = draw_clips(samples, Protocol(num_clips=60_000), 0, REAL)
    start = clips.first_row - samples.sequences.start_row[clips.sequence]
    assert (start >= 0).all()
    assert (start + clips.num_poses <= samples.sequences.num_frames[clips.sequence]).all()
    assert 2 not in clips.sequence
    short = (clips.sequence == 1) & (clips.num_poses == 16)
    assert (start[short].min(), start[short].max()) == (0, 84)
    assert np.bincount(start[short], minlength=85).min() > 0


def test_features_come_in_the_order_of_the_clips() -> None:
    samples = ramps("ramps", [80, 90])
    clips = draw_clips(samples, SMALL, 0, REAL)
    described = describer(samples, FirstAndLastHeight())(clips)
    np.testing.assert_array_equal(described[:, 0], samples.sequences.values[clips.first_row, 0, 1])
    np.testing.assert_array_equal(described[:, 1] - described[:, 0], clips.num_poses - 1)


def test_too_short_sequences_are_refused_with_the_reason() -> None:
    samples = ramps("tiny", [40, 30])
    with pytest.raises(ClipError, match=r"tiny: no sequence has the 64 poses .* the longest has 40"):
        SMALL.check_lengths(samples)
    with pytest.raises(ClipError, match=r"tiny: no sequence among 2 has \d+ poses"):
        draw_clips(samples, SMALL, 0, REAL)
    assert draw_clips(samples, Protocol(16, 40), 0, REAL).num_poses.max() == 40


def test_a_copy_scores_the_floor_and_a_change_scores_more() -> None:
    real = ramps("real", [200] * 40)
    rows = {"copy": real, "moved": ramps("moved", [200] * 40, offset=8000.0)}
    scores = Comparison(real, FirstAndLastHeight(), SMALL).scores(rows)
    assert 0 < scores["copy"].value < 0.05 * scores["moved"].value
    assert scores["copy"].details["coverage"] > 0.9


def statues(heights: np.ndarray) -> SampleSet:
    sequences = [np.full((100, 22, 3), height, dtype=np.float32) for height in heights]
    return sample_set("statues", FPS, sequences, [str(i) for i in range(len(heights))])


def test_disjoint_halves_score_more_than_independent_draws() -> None:
    real = statues(np.random.default_rng(0).normal(size=12))
    comparison = Comparison(real, FirstAndLastHeight(), SMALL)
    assert comparison.disjoint_halves().value > 5 * comparison.scores({"P1": real})["P1"].value
    with pytest.raises(ClipError, match="no sequence among 0"):
        Comparison(real.select([0]), FirstAndLastHeight(), SMALL).disjoint_halves()


@pytest.fixture
def motions(monkeypatch: pytest.MonkeyPatch) -> list[mk.Motion]:
    """Eight analytic motions of three seconds at 60 fps; the descriptor is fitted on few clips."""
    monkeypatch.setattr(score, "FIT_CLIPS", 512)
    actions = [*ACTIONS, "walk", "bow"]
    return [to_motion(analytic_motion(action, 3.0, seed), FPS) for seed, action in enumerate(actions)]


def test_motions_in_memory_have_the_number_of_the_definition(motions: list[mk.Motion]) -> None:
    slowed = [mk.complete(motion.resample(5), fps=60, model="slerp") for motion in motions]
    found = clip_fid(motions, slowed, **FEW)
    names = [str(number) for number in range(len(motions))]
    real, row = (sample_set("set", FPS, [m.joint_positions for m in each], names) for each in (motions, slowed))
    protocol = Protocol(num_clips=256, replications=3, detailed_replications=0)
    assert KINEMATIC.comparison(real, real, protocol).scores({"row": row})["row"] == found
    assert clip_fid(list(real.sequences), list(row.sequences), fps="60", **FEW) == found
    floor = clip_fid(motions, motions, **FEW)
    assert floor.value + floor.ci95 < found.value - found.ci95
    assert str(floor) == f"{floor.value:.4g} ± {floor.ci95:.2g}"
    assert clip_fid(motions[:1], motions[:1], **FEW).value == pytest.approx(0.0, abs=1e-9)


def test_another_skeleton_is_brought_to_the_22_joints(motions: list[mk.Motion], tmp_path) -> None:
    for number, motion in enumerate(motions):
        motion.save(tmp_path / f"{number}.bvh")
    read = list(mk.read_all(tmp_path, unit_metres=0.01))
    assert read[0].skeleton.joint_names != motions[0].skeleton.joint_names
    mixed, same = clip_fid(motions, read, **FEW), clip_fid(motions, motions, **FEW)
    assert mixed.value == pytest.approx(same.value, rel=0.05)


def test_what_cannot_be_compared_is_refused(motions: list[mk.Motion]) -> None:
    half, arrays = [motion.resample(30) for motion in motions], [motion.joint_positions for motion in motions]
    for arguments, fps in (((motions, half), None), ((motions, motions), 30), ((arrays, arrays), None)):
        with pytest.raises(mk.UsageError):
            clip_fid(*arguments, fps=fps)
    with pytest.raises(ClipError, match="generated holds no motion"):
        clip_fid(motions, [])
    with pytest.raises(ClipError, match="16 poses"):
        clip_fid(motions, [motion.frames(0, 10) for motion in motions], **FEW)
