"""Copies of training motion are found under every disguise, and nothing else is."""

from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest

from eval.sets.damage import jitter, upsample_slerp, with_bones_of
from eval.sets.motions import TrainingWindows, low_pass
from eval.sets.sets import RowId, SampleSet, sample_set
from eval.tables.nerm.table2 import COPIED, HELD_OUT, copies_block
from motionkit.core.motion import mirror_positions
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import rest_positions
from motionkit.fields.resample import resample_positions

FPS = Fraction(60)


def swinging(seed: int, seconds: float, fps: Fraction = FPS) -> np.ndarray:
    """A body whose joints swing at frequencies of their own, as it walks along."""
    rng = np.random.default_rng(seed)
    times = np.arange(round(seconds * fps))[:, None, None] / float(fps)
    rate, phase = rng.uniform(0.2, 2, (22, 3)), rng.uniform(0, 6, (22, 3))
    return (
        rest_positions(SMPL22) + 0.05 * np.sin(2 * np.pi * rate * times + phase) + np.array([0.3, 0, 0.4]) * times
    ).astype(np.float32)


def as_set(*sequences: np.ndarray, fps: Fraction = FPS) -> SampleSet:
    found = [np.ascontiguousarray(each, dtype=np.float32) for each in sequences]
    return sample_set("some", fps, found, [str(index) for index in range(len(found))])


TRAINING = as_set(*(swinging(seed, seconds) for seed, seconds in enumerate((3.0, 1.0, 9.0, 4.0))))
TAKE = swinging(2, 9.0)[130:370]
FRESH = as_set(*(swinging(seed, 6.0) for seed in range(20, 40)))
BONES = 1 + 0.15 * np.sin(np.arange(22))


def elsewhere(positions: np.ndarray) -> np.ndarray:
    """Turned by 2 rad about the vertical and moved."""
    turn = np.array([[np.cos(2), 0, np.sin(2)], [0, 1, 0], [-np.sin(2), 0, np.cos(2)]])
    return (positions @ turn.T + np.array([5.0, 0.3, -2.0])).astype(np.float32)


def mirrored(positions: np.ndarray) -> np.ndarray:
    return mirror_positions(positions, SMPL22.left_right_pairs)


def played(positions: np.ndarray, tempo: str) -> np.ndarray:
    return resample_positions(positions, FPS * Fraction(tempo), FPS)


def noisy(positions: np.ndarray, metres: float) -> np.ndarray:
    return jitter(positions, float(FPS), metres, np.random.default_rng(0))


DISGUISES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "none": lambda take: take,
    "elsewhere": elsewhere,
    "1.1 × taller": lambda take: take * np.float32(1.1),
    "other proportions": lambda take: with_bones_of(take.astype(float), take * BONES[:, None]),
    "0.8 × the tempo": lambda take: played(take, "0.8"),
    "1.25 × the tempo": lambda take: played(take, "1.25"),
    "mirrored": mirrored,
    "noise": lambda take: noisy(take, 0.003),
    "low-passed": lambda take: low_pass(take, float(FPS), 8.0),
    "from 20 fps": lambda take: upsample_slerp(take, float(FPS), 20.0, np.random.default_rng(0)),
    "spliced": lambda take: np.concatenate((take[:120], swinging(0, 3.0)[20:140])),
    "all at once": lambda take: noisy(elsewhere(mirrored(played(1.1 * take, "1.11"))), 0.001),
}


@pytest.fixture(scope="module")
def windows() -> TrainingWindows:
    return TrainingWindows.of(TRAINING)


@pytest.fixture(scope="module")
def limit(windows: TrainingWindows) -> float:
    return float(np.quantile(windows.nearest(FRESH).relative, 0.01))


@pytest.mark.parametrize("name", DISGUISES)
def test_every_disguise_of_a_take_is_nearer_than_fresh_motion(
    windows: TrainingWindows, limit: float, name: str
) -> None:
    nearest = windows.nearest(as_set(DISGUISES[name](TAKE)))
    assert (nearest.relative < limit).mean() > 0.6


def test_a_window_is_as_far_as_its_bones_are(windows: TrainingWindows) -> None:
    """One arm bone that points elsewhere by a known angle, all else the same."""
    take = TAKE.astype(float).copy()
    hand, elbow = SMPL22.index("left_wrist"), SMPL22.index("left_elbow")
    bone = take[:, hand] - take[:, elbow]
    bent = np.stack([bone[:, 0], bone[:, 2], -bone[:, 1]], axis=-1)
    take[:, hand] = take[:, elbow] + bent
    same, other = (float(np.median(windows.nearest(as_set(each)).distance)) for each in (TAKE, take))
    length = np.linalg.norm(SMPL22.offsets[hand])
    angle = np.arccos((bone * bent).sum(axis=-1) / np.square(bone).sum(axis=-1))
    expected = np.sqrt(np.mean(np.square(2 * length * np.sin(angle / 2))) / 21)
    assert same < 0.15 * other and other == pytest.approx(expected, rel=0.2)


def test_what_stands_still_or_is_short_has_no_windows(windows: TrainingWindows) -> None:
    still = as_set(np.repeat(TAKE[:1], 240, axis=0), TAKE[:40])
    assert not len(windows.nearest(still).distance)
    with pytest.raises(ValueError, match="second"):
        TrainingWindows.of(as_set(TAKE[:40]))


def test_the_block_separates_a_model_that_copies_from_one_that_does_not() -> None:
    models = {RowId("copies"): as_set(TAKE, elsewhere(TAKE)), RowId("invents"): as_set(swinging(50, 6.0))}
    block = copies_block(FRESH, TRAINING, models)
    shares = {row.name: row.cells[COPIED].value for row in block.rows}
    assert shares["copies"] > 90 and shares["invents"] < 10 and shares[str(HELD_OUT)] <= 2
