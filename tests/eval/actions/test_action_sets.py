"""Motions of the actions that a recogniser knows."""

from fractions import Fraction

import pytest

from eval.actions.sets import NoActionsError, known_actions
from eval.sets.sets import sample_set
from tests.helpers.acting import acted

FPS = Fraction(20)


def test_actions_are_found_however_they_are_spelt_and_single_motions_are_left_out() -> None:
    names = ("Warm_Up", "warm up", "JUMP", "jump", "jump", "sit", "", "fly", "hop", "hop")
    lengths = (40, 40, 40, 40, 5, 40, 40, 40, 40, 5)
    made = [acted("nod", i, length) for i, length in enumerate(lengths)]
    samples = sample_set("some", FPS, made, [str(i) for i in range(10)], actions=names)
    found = known_actions(samples, ("warm-up", "jump", "sit", "hop"))
    assert found.samples.sequence_ids == ("0", "1", "2", "3") and found.labels.tolist() == [0, 0, 1, 1]
    assert found.left_out == (
        "2 motions of actions that it does not know: fly (1), no action (1)",
        "actions with a single motion: sit, hop",
        "2 motions of fewer than 10 frames",
    )
    with pytest.raises(NoActionsError, match=r"some: no motion has an action that the recogniser knows \(dance\)"):
        known_actions(samples, ("dance",))
