"""The drill: each fault happens or is named, careless commands and wrong readers are found, ours are neither."""

import math
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from random import Random

import numpy as np
import pytest

from benchmarks.trust import crash, fuzz
from benchmarks.trust.crash import Drill, difference, tree
from benchmarks.trust.fuzz import Target, all_targets, written_targets
from benchmarks.trust.mutate import flip, mutate
from benchmarks.trust.process import Fault
from benchmarks.trust.scenarios import STARTS, Scenario
from motionkit.core.errors import MotionkitError

CARELESS = "call:tests.benchmarks.test_trust:"
CAREFUL = Scenario("careful", "nothing", (f"{CARELESS}write_carefully", "letters"), store="", whole=("letters",))
COUNTING = Scenario("counting", "one", (f"{CARELESS}count_up", "number"), store="", whole=("number",))


def count_up(name: str) -> None:
    """Make a number greater by one, up to two, in its place."""
    path = Path(name)
    number = int(path.read_text()) if path.exists() else 0
    path.write_text("")
    with path.open("w") as handle:
        handle.write(str(min(number + 1, 2)))


def write_carefully(name: str) -> None:
    """Write a file beside its place first."""
    path = Path(name)
    pending = path.with_name(f".{path.name}.new")
    pending.write_text("x" * 10_000)
    pending.replace(path)


@pytest.fixture
def drill(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Drill:
    monkeypatch.setitem(STARTS, "nothing", ("", ()))
    monkeypatch.setitem(STARTS, "one", ("", (COUNTING.command,)))
    return Drill(tmp_path)


def test_file_operations_are_counted_and_killed_before(drill: Drill) -> None:
    assert drill.prepare(CAREFUL).operations == ("open .letters.new", "os.rename .letters.new")
    place = drill.folder / "place"
    (place / "letters").unlink()
    for number, left in ((0, set()), (1, {".letters.new"})):
        assert drill.run(CAREFUL, place, Fault("operation", number)).code == -signal.SIGKILL
        assert set(tree(place)) == left


def test_a_file_is_cut_at_a_byte(drill: Drill) -> None:
    drill.prepare(CAREFUL)
    place = drill.folder / "place"
    (place / "letters").unlink()
    assert drill.run(CAREFUL, place, Fault("bytes", 1234)).code == -signal.SIGXFSZ
    assert len((place / ".letters.new").read_bytes()) == 1234
    outcome = drill.run(CAREFUL, place, Fault("limit", 1000))
    assert (outcome.code, outcome.err) == (1, "motionkit: [Errno 27] File too large\n")


def test_what_is_left_over_and_what_is_lost_are_found(drill: Drill) -> None:
    assert drill.attempt(CAREFUL, Fault("operation", 0)) == ""
    assert drill.attempt(COUNTING, Fault("operation", 1)) == "number is half written"
    assert "failed without saying what with" in drill.attempt(CAREFUL, Fault("limit", 1000))


def test_trees_differ_in_names_and_contents_and_not_in_clocks(tmp_path: Path) -> None:
    for name, seconds in (("one", 1.5), ("two", 2.5)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "metrics.jsonl").write_text(f'{{"step": 1, "seconds": {seconds}}}\n')
    one = tree(tmp_path / "one")
    assert difference(tree(tmp_path / "two"), one) == ""
    (tmp_path / "two" / "metrics.jsonl").write_text('{"step": 2, "seconds": 2.5}\n')
    (tmp_path / "two" / ".model.tmp").touch()
    assert difference(tree(tmp_path / "two"), one) == "left over: .model.tmp; different: metrics.jsonl"


def test_nothing_is_lost_by_kills(tmp_path: Path) -> None:
    """A slice of `python -m benchmarks.trust crash`."""
    report = crash.run(0, math.inf, tmp_path, ("append",), 8)
    assert report.failures == ()
    assert report.plain()["tried"] == 8


# `MOTIONKIT_FUZZ_INPUTS=2000 pytest tests/benchmarks/test_trust.py` hunts for longer.
INPUTS_EACH = int(os.environ.get("MOTIONKIT_FUZZ_INPUTS", "10"))


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
def test_each_fault_is_found_and_named(tmp_path, monkeypatch, wrong, failure):
    monkeypatch.setattr(fuzz, "MOST_SECONDS", 0.1)
    report = fuzz.run(5, math.inf, tmp_path, [reader(wrong)], 3)
    assert report.failures
    assert all(each.startswith("wrong: wrong:5:") and failure in each for each in report.failures)


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
def test_each_outcome_is_distinguished(use, failure, outcome, tmp_path):
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
