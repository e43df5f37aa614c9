"""The drill's crashes: each fault happens, a careless command is found out, and ours lose nothing."""

import math
import signal
from pathlib import Path

import pytest

from benchmarks.trust import crash
from benchmarks.trust.crash import Drill, difference, tree
from benchmarks.trust.process import Fault
from benchmarks.trust.scenarios import STARTS, Scenario

CARELESS = "call:tests.helpers.careless:"
CAREFUL = Scenario("careful", "nothing", (f"{CARELESS}write_carefully", "letters"), store="", whole=("letters",))
COUNTING = Scenario("counting", "one", (f"{CARELESS}count_up", "number"), store="", whole=("number",))


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
