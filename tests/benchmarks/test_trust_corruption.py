"""The drill's flipped bytes: each outcome is distinguished, and ours are all noticed."""

import math
from collections.abc import Callable
from pathlib import Path
from random import Random

import pytest

from benchmarks.trust import fuzz
from benchmarks.trust.corruption import targets
from benchmarks.trust.crash import Drill
from benchmarks.trust.fuzz import Target
from benchmarks.trust.mutate import flip
from motionkit.core.errors import MotionkitError

LETTERS = bytes(65 + number % 26 for number in range(200))


def refuse(message: str) -> Callable[[Path], object]:
    def use(folder: Path) -> object:
        if (folder / "letters").read_bytes() != LETTERS:
            raise MotionkitError(message)
        return None

    return use


@pytest.mark.parametrize(
    ("use", "failure", "outcome"),
    [
        (lambda folder: None, "", "read"),
        (refuse("letters is damaged"), "", "refused"),
        (refuse("something is damaged"), "letters: not named: something is damaged", "failed"),
        (lambda folder: sum((folder / "letters").read_bytes()), "letters: missed", "failed"),
    ],
)
def test_each_outcome_is_distinguished(
    use: Callable[[Path], object], failure: str, outcome: str, tmp_path: Path
) -> None:
    target = Target("letters", lambda folder: (folder / "letters").write_bytes(LETTERS), use, exact=True)
    [case] = fuzz.run(3, math.inf, tmp_path, [target], 8).cases
    assert case.figures == {outcome: 8}
    assert list(case.failures) == [f"letters:3:{number}: {failure}" for number in range(8) if failure]


def test_a_flip_changes_one_byte_and_is_made_again() -> None:
    flips = [flip(Random(number), bytes(1000)) for number in range(200)]
    assert flips == [flip(Random(number), bytes(1000)) for number in range(200)]
    assert all(sum(map(bool, content)) == 1 for content in flips)


def test_every_flip_in_a_store_is_noticed(tmp_path: Path) -> None:
    """A slice of `python -m benchmarks.trust corruption`: the kinds whose starting folder is made in seconds."""
    kinds = [target for target in targets(Drill(tmp_path / "drill")) if target.name.startswith("store")]
    assert fuzz.run(0, math.inf, tmp_path / "flips", kinds, 8).failures == ()
