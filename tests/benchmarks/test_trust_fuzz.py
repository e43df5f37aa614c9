"""The drill's fuzz and flipped bytes: what a reader does wrong is found and named, and ours do nothing wrong."""

import math
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from random import Random

import numpy as np
import pytest

from benchmarks.trust import fuzz
from benchmarks.trust.crash import Drill
from benchmarks.trust.fuzz import Target, all_targets, written_targets
from benchmarks.trust.mutate import flip, mutate
from motionkit.core.errors import MotionkitError

# `MOTIONKIT_FUZZ_INPUTS=2000 pytest tests/benchmarks/test_trust_fuzz.py` hunts for longer.
INPUTS_EACH = int(os.environ.get("MOTIONKIT_FUZZ_INPUTS", "10"))


def refuse() -> None:
    raise MotionkitError("take.txt is damaged")


def spend_time() -> None:
    while True:
        time.process_time()


def reader(wrong: Callable[[], object]) -> Target:
    """A reader that does this with what the file holds, unless nothing has happened to it."""

    def use(folder: Path) -> None:
        if (folder / "take.txt").read_bytes() != b"1 2 3\n":
            wrong()

    return Target("wrong", lambda folder: (folder / "take.txt").write_text("1 2 3\n"), use)


@pytest.mark.parametrize(
    ("wrong", "failure"),
    [
        (lambda: int("x"), "ValueError: invalid literal"),
        (lambda: np.ones(1 << 28).sum(), "MemoryError"),
        (lambda: np.float32(1e30) * np.float32(1e30), "RuntimeWarning: overflow"),
        (lambda: os.kill(os.getpid(), signal.SIGSEGV), "ended by SIGSEGV"),
        (spend_time, "ended by SIGPROF"),
    ],
)
def test_each_fault_is_found_and_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wrong: Callable[[], object], failure: str
) -> None:
    monkeypatch.setattr(fuzz, "MOST_SECONDS", 0.1)
    report = fuzz.run(5, math.inf, tmp_path, [reader(wrong)], 3)
    assert report.failures
    assert all(each.startswith("wrong: wrong:5:") and failure in each for each in report.failures)


def test_what_is_refused_or_read_is_no_fault(tmp_path: Path) -> None:
    [refused] = fuzz.run(0, math.inf, tmp_path / "refused", [reader(refuse)], 30).cases
    [read] = fuzz.run(0, math.inf, tmp_path / "read", [reader(lambda: None)], 30).cases
    assert refused.figures["refused"] > 20
    assert (read.failures, read.figures["read"]) == ((), 30)


def test_an_input_is_made_again(tmp_path: Path) -> None:
    for target in all_targets():
        folder = tmp_path / target.name
        folder.mkdir()
        target.make(folder)
        path = min(each for each in folder.rglob(target.pattern) if each.is_file())
        first, again = (mutate(Random(7), path.name, path.read_bytes()) for _ in range(2))
        assert first == again


@pytest.mark.parametrize("target", list(all_targets()), ids=lambda target: target.name)
def test_every_reader_explains_what_is_wrong(tmp_path: Path, target: Target) -> None:
    """A slice of `python -m benchmarks.trust fuzz`."""
    assert fuzz.run(0, math.inf, tmp_path, [target], INPUTS_EACH).failures == ()


LETTERS = bytes(65 + number % 26 for number in range(200))


def refuse_changes(message: str) -> Callable[[Path], object]:
    def use(folder: Path) -> object:
        if (folder / "letters").read_bytes() != LETTERS:
            raise MotionkitError(message)
        return None

    return use


@pytest.mark.parametrize(
    ("use", "failure", "outcome"),
    [
        (lambda folder: None, "", "read"),
        (refuse_changes("letters is damaged"), "", "refused"),
        (refuse_changes("something is damaged"), "letters: not named: something is damaged", "failed"),
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
    kinds = [target for target in written_targets(Drill(tmp_path / "drill")) if target.name.startswith("store")]
    assert fuzz.run(0, math.inf, tmp_path / "flips", kinds, 8).failures == ()
