"""One framerate's cells: rows that are too short for the largest clips are missing, and say so."""

from fractions import Fraction

import numpy as np

from eval.clip_fid.clips import PoseRange, Protocol
from eval.clip_fid.features import Comparison
from eval.clip_fid.score import score_rows
from eval.sets.sets import SampleSet, sample_set
from eval.tables.nerm.clip_fid_column import P1, P2, score_column
from tests.eval.clip_fid.test_calibration import MeanHeight

FPS = Fraction(20)
PROTOCOL = Protocol(PoseRange(8, 16), num_clips=64, replications=2, detailed_replications=0)


def takes(name: str, num_takes: int, frames: int = 40) -> SampleSet:
    rng = np.random.default_rng(len(name))
    made = [rng.normal(size=(frames, 22, 3)).cumsum(axis=0).astype(np.float32) for _ in range(num_takes)]
    return sample_set(name, FPS, made, [str(take) for take in range(num_takes)])


def test_cells_are_the_scores_of_the_rows_that_fit() -> None:
    real, other = takes("real", 4), takes("other", 4)
    rows = {P1: real, "other": other, "short": takes("short", 3, frames=12)}
    found = score_column(Comparison(real, MeanHeight(), PROTOCOL), rows)
    assert set(found.value) == {P1, P2, "other"}
    (told,) = found.missing
    assert told.startswith("short, 20 fps: short: no sequence has the 16 poses")
    expected = score_rows(real, {"other": other}, MeanHeight(), PROTOCOL)["other"].clip_fid
    assert (found.value["other"].value, found.value["other"].ci95) == (expected.mean, expected.ci95)


def test_one_take_has_no_halves() -> None:
    real = takes("real", 1)
    comparison = Comparison(real, MeanHeight(), PROTOCOL)
    found = score_column(comparison, {P1: real})
    assert set(found.value) == {P1}
    assert found.missing == (f"{P2}, 20 fps: real: 1 take cannot be split into two halves",)
    assert not score_column(comparison, {P1: real}, halves=False).missing
