"""One framerate's cells: rows that are too short for the largest clips are missing, and say so."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from eval.clip_fid.score import Comparison, Protocol
from eval.sets.sets import Missing, RowId, SampleSet, sample_set
from eval.tables.systems import MOTIONS, P1, P2, SLERP, TAKES, TRAINING, score_column
from tests.eval.tables.test_calibration import MeanHeight

FPS = Fraction(20)
PROTOCOL = Protocol(8, 16, num_clips=64, replications=2, detailed_replications=0)


def takes(name: str, num_takes: int, frames: int = 40) -> SampleSet:
    rng = np.random.default_rng(len(name))
    made = [rng.normal(size=(frames, 22, 3)).cumsum(axis=0).astype(np.float32) for _ in range(num_takes)]
    return sample_set(name, FPS, made, [str(take) for take in range(num_takes)])


def test_cells_are_the_scores_of_the_rows_that_fit() -> None:
    real, other = takes("real", 4), takes("other", 4)
    own, short = RowId("other"), RowId("short")
    rows = {P1: real, own: other, short: takes("short", 3, frames=12)}
    missing = Missing()
    cells, differences = score_column(Comparison(real, MeanHeight(), PROTOCOL), rows, missing)
    assert set(cells) == {P1, P2, own}
    (told,) = missing.lines
    assert told.startswith("short, 20 fps: short: no sequence has the 16 poses")
    expected = Comparison(real, MeanHeight(), PROTOCOL).scores({"other": other})["other"]
    cell = cells[own]
    assert (cell.value, cell.ci95) == (expected.value, expected.ci95)
    assert (cell.details[MOTIONS], cell.details[TAKES]) == (4, 4)
    assert (cells[P2].details[MOTIONS], differences) == (2, {})


def test_one_take_has_no_halves() -> None:
    comparison = Comparison(takes("real", 1), MeanHeight(), PROTOCOL)
    missing = Missing()
    cells, _ = score_column(comparison, {P1: comparison.real}, missing)
    assert set(cells) == {P1} and cells[P1].ci95 is None  # one take says nothing of others
    assert [line.partition(": ")[0] for line in missing.lines] == [f"{P2}, 20 fps"]


def test_rows_are_compared_with_one_another_and_with_upsampling() -> None:
    real = takes("real", 12)
    near, far = RowId("near"), RowId("far")
    rows = {P1: real, SLERP: real, near: takes("near1", 12), far: moved(takes("far", 12), 50.0)}
    cells, differences = score_column(Comparison(real, MeanHeight(), PROTOCOL), rows, Missing(), halves=False)
    assert set(differences) == {(near, far), (near, SLERP), (far, SLERP)}
    difference = differences[near, far]
    assert difference.verdict == "lower"
    assert difference.value == cells[near].value - cells[far].value
    assert differences[far, SLERP].verdict == "higher"


def test_a_row_of_subsets_has_the_spread_of_single_ones() -> None:
    real, train = takes("real", 12), takes("training", 30)
    comparison = Comparison(real, MeanHeight(), replace(PROTOCOL, replications=12))
    rows = {P1: real, TRAINING: train}
    few, many = (
        score_column(comparison, rows, Missing(), subset_sizes={TRAINING: size}, halves=False)[0][TRAINING]
        for size in (4, 30)
    )
    assert (few.details[TAKES], many.details[TAKES]) == (4, 30)
    assert few.value > many.value
    assert few.ci95 is not None and many.ci95 is not None and few.ci95 > 2 * many.ci95
    drawing = [cell for name, cell in few.details.items() if name.startswith("±")]
    assert drawing == [pytest.approx(few.ci95 / np.sqrt(12))]


def moved(samples: SampleSet, metres: float) -> SampleSet:
    return samples.with_positions([sequence + np.float32(metres) for sequence in samples.sequences])
