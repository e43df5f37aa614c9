"""The recogniser fitted on a store's own actions: against scikit-learn, on motions that are known apart; refusals."""

from fractions import Fraction

import numpy as np
import pytest
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis

from eval.actions.recogniser import LEAST_SPREAD, SHRINKAGE, fit_linear, motion_statistics, statistics_of
from eval.sets.sets import SampleSet, sample_set
from motionkit.core.errors import MotionkitError
from tests.helpers.acting import ACTIONS, acted

FPS = Fraction(20)


def motions(count: int, seed: int, actions: tuple[str, ...] = ACTIONS) -> SampleSet:
    names = [action for action in actions for _ in range(count)]
    made = [acted(name, seed + i) for i, name in enumerate(names)]
    return sample_set("made", FPS, made, [str(i) for i in range(len(names))], actions=names)


def test_it_is_linear_discriminant_analysis() -> None:
    train, held_out = motions(12, 0), motions(5, 500)
    recogniser = fit_linear(train)
    raw = statistics_of(train)
    centre, spread = raw.mean(axis=0), raw.std(axis=0) + LEAST_SPREAD
    standard = (raw - centre) / spread
    labels = np.array([ACTIONS.index(action) for action in train.actions])
    means = np.stack([standard[labels == label].mean(axis=0) for label in range(3)])
    within = np.cov((standard - means[labels]).T, bias=True)
    shrunk = (1 - SHRINKAGE) * within + SHRINKAGE * np.trace(within) / len(within) * np.eye(len(within))
    x = (statistics_of(held_out) - centre) / spread
    inverse = np.linalg.inv(shrunk)
    by_hand = x @ inverse @ means.T - 0.5 * (means @ inverse * means).sum(axis=1)
    _, ours = recogniser.recognise(held_out)
    np.testing.assert_allclose(ours - ours[:, :1], by_hand - by_hand[:, :1], rtol=1e-6, atol=1e-6)
    theirs = LinearDiscriminantAnalysis(solver="eigen", shrinkage=SHRINKAGE).fit(standard, labels)
    np.testing.assert_array_equal(ours.argmax(axis=1), theirs.predict(x))


def test_statistics_do_not_depend_on_place_heading_or_length_beyond_what_they_see() -> None:
    body = acted("nod", 3)
    turned = body[:, :, [2, 1, 0]] * np.float32([1, 1, -1]) + np.float32([4, 0, -1])
    np.testing.assert_allclose(motion_statistics(body, 20.0), motion_statistics(turned, 20.0), atol=2e-4)
    long = acted("nod", 3, num_frames=200)
    whole = sample_set("long", FPS, [long], ["a"])
    part = sample_set("part", FPS, [long[70:130]], ["a"])
    np.testing.assert_array_equal(statistics_of(whole), statistics_of(part))


def test_what_cannot_be_learnt_or_described_is_said() -> None:
    with pytest.raises(MotionkitError, match="made: 0 actions have 10 motions or more at 20 fps"):
        fit_linear(motions(9, 0))
    rare = sample_set(
        "rare",
        FPS,
        [acted(action, i) for i, action in enumerate([*ACTIONS[:2] * 10, ACTIONS[2]])],
        [str(i) for i in range(21)],
        actions=[*ACTIONS[:2] * 10, ACTIONS[2]],
    )
    assert fit_linear(rare).actions == ACTIONS[:2]
