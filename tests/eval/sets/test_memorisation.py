"""Copies are found wherever they stand, whichever way they face and whenever they begin; other motions are not."""

from fractions import Fraction

import numpy as np
import pytest

from eval.sets import memorisation
from eval.sets.memorisation import distances_to_training
from eval.sets.sets import SampleSet, sample_set
from eval.tables.nerm.clip_fid_column import HELD_OUT, MIRRORED, nearest_training_block
from motionkit.core.mirror import mirror_positions
from motionkit.core.skeleton import SMPL22

FPS = Fraction(20)


def swinging(seed: int, seconds: float) -> np.ndarray:
    """A body whose joints swing at frequencies of its own, as it walks along."""
    rng = np.random.default_rng(seed)
    rest = np.zeros((22, 3))
    for joint, parent in enumerate(SMPL22.parents[1:], start=1):
        rest[joint] = rest[parent] + SMPL22.offsets[joint]
    times = np.arange(round(seconds * 20))[:, None, None] / 20
    rate, phase = rng.uniform(0.2, 2, (22, 3)), rng.uniform(0, 6, (22, 3))
    return (rest + 0.1 * np.sin(2 * np.pi * rate * times + phase) + np.array([0.3, 0, 0.4]) * times).astype(np.float32)


def as_set(*sequences: np.ndarray, fps: Fraction = FPS) -> SampleSet:
    return sample_set("some", fps, sequences, [str(index) for index in range(len(sequences))])


def elsewhere(positions: np.ndarray) -> np.ndarray:
    """Turned by 2 rad about the vertical and moved."""
    turn = np.array([[np.cos(2), 0, np.sin(2)], [0, 1, 0], [-np.sin(2), 0, np.cos(2)]])
    return (positions @ turn.T + np.array([5.0, 0.3, -2.0])).astype(np.float32)


TRAINING = as_set(*(swinging(seed, seconds) for seed, seconds in enumerate((3.0, 1.0, 12.0, 4.0))))


@pytest.mark.parametrize("block", [7, 4096])
def test_copies_of_any_part_are_near_zero(monkeypatch: pytest.MonkeyPatch, block: int) -> None:
    monkeypatch.setattr(memorisation, "BLOCK_STRETCHES", block)
    copies = as_set(elsewhere(swinging(2, 12.0)[30:80]), swinging(0, 3.0), swinging(3, 4.0)[36:])
    new = as_set(swinging(20, 3.0), swinging(21, 8.0))
    assert distances_to_training(copies, TRAINING).max() < 1e-4
    assert distances_to_training(new, TRAINING).min() > 0.02


def test_the_distance_is_the_mean_joint_distance_of_the_nearest_stretch() -> None:
    """A left hand 10 cm off in every pose is 100 / 21 mm on the average over the joints but the root."""
    off = swinging(3, 4.0)
    off[:, 20, 1] += 0.1
    [found] = distances_to_training(as_set(off), TRAINING)
    assert found == pytest.approx(0.1 / 21, rel=1e-3)


def test_what_is_shorter_than_a_stretch_has_no_distance() -> None:
    assert len(distances_to_training(as_set(swinging(9, 1.9), swinging(9, 2.0)), TRAINING)) == 1
    with pytest.raises(ValueError, match="nothing to look"):
        distances_to_training(as_set(swinging(9, 3.0)), as_set(swinging(1, 1.0)))


def test_other_framerates_are_refused() -> None:
    with pytest.raises(ValueError, match="30 fps"):
        distances_to_training(as_set(swinging(9, 3.0), fps=Fraction(30)), TRAINING)


def test_the_block_tells_a_model_that_copies_from_one_that_does_not() -> None:
    copying = as_set(*(elsewhere(swinging(2, 12.0)[start : start + 60]) for start in (0, 50, 100)))
    held_out = as_set(*(swinging(seed, 4.0) for seed in range(30, 40)))
    sets = {"copying": copying, "too short": as_set(swinging(0, 1.0))}
    block = nearest_training_block(held_out, TRAINING, sets, {"copying": "says so"})
    rows = {row.name: row for row in block.rows}
    assert set(rows) == {HELD_OUT, HELD_OUT + MIRRORED, "copying", "copying" + MIRRORED}
    assert rows["copying"].cells["95 %"].value < 0.1 < 20 < rows[HELD_OUT].cells["nearest"].value
    assert rows["copying"].note == "3 motions; says so"
    assert rows["copying" + MIRRORED].cells["nearest"].value > 20
    # Who copies mirrored motion is found out by the row of mirror images alone.
    images = as_set(*(mirror_positions(sequence, SMPL22.left_right_pairs) for sequence in copying.sequences))
    mirrored = {row.name: row for row in nearest_training_block(held_out, TRAINING, {"it": images}, {}).rows}
    assert mirrored["it"].cells["nearest"].value > 20 > 0.1 > mirrored["it" + MIRRORED].cells["95 %"].value
    values = [rows[HELD_OUT].cells[column].value for column in block.columns]
    assert values == sorted(values)
