"""The drill's crashes: each fault happens, a careless command is found out, and ours lose nothing."""

import math
import signal
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path

import pytest

from benchmarks.trust import crash
from benchmarks.trust.faults import Fault
from benchmarks.trust.missing import fault_of
from benchmarks.trust.process import Commands, one_thread
from benchmarks.trust.scenarios import SCENARIOS, STARTS, Scenario, ingest, takes
from benchmarks.trust.trees import copy, difference, tree
from benchmarks.trust.trials import Drill

CARELESS = "call:tests.helpers.careless:"
CAREFUL = Scenario("careful", "nothing", (f"{CARELESS}write_carefully", "letters"), store="", whole=("letters",))
COUNTING = Scenario("counting", "one", (f"{CARELESS}count_up", "number"), store="", whole=("number",))
SLICE = ("ingest", "append")
NUM_FAULTS = 8


@pytest.fixture
def drill(commands: Commands, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Drill:
    monkeypatch.setitem(STARTS, "nothing", ("", ()))
    monkeypatch.setitem(STARTS, "one", ("", (COUNTING.command,)))
    return Drill(commands, tmp_path, disk=None)


def test_file_operations_are_counted_and_killed_before(drill: Drill) -> None:
    expected = drill.prepare(CAREFUL)
    assert expected.operations == ("open .letters.new", "os.rename .letters.new")
    place = drill.folder / "place"
    (place / "letters").unlink()
    for number, left in ((0, {}), (1, {".letters.new"})):
        assert drill.run(CAREFUL, place, Fault("operation", number)).code == -signal.SIGKILL
        assert set(tree(place)) == set(left)


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
    problem = drill.attempt(COUNTING, Fault("operation", 1))
    assert problem == "number is half written"
    assert "failed without saying what with" in drill.attempt(CAREFUL, Fault("limit", 1000))


def test_a_forked_command_is_the_command(commands: Commands, tmp_path: Path) -> None:
    """Exit code, words and files are those of a process that the shell starts."""
    assert commands.run(tmp_path, takes("takes", 0, 2)).code == 0
    for arguments in (ingest("takes"), ("ingest", "nowhere", "--store", "store"), ("remove", "nobody")):
        ends = []
        for name in ("forked", "started"):
            place = tmp_path / name
            if not place.exists():
                copy(tmp_path / "takes", place / "takes")
            if name == "forked":
                outcome = commands.run(place, arguments)
                ends.append((outcome.code, outcome.out, outcome.err))
            else:
                command = [sys.executable, "-m", "motionkit", *arguments]
                done = subprocess.run(command, cwd=place, env=one_thread(), capture_output=True, text=True, check=False)
                ends.append((done.returncode, done.stdout, done.stderr))
        assert ends[0] == ends[1]
        assert tree(tmp_path / "forked") == tree(tmp_path / "started")


def test_a_file_that_is_missing_may_be_reported_and_no_traceback(commands: Commands, tmp_path: Path) -> None:
    assert fault_of(commands.run(tmp_path, ("info", "--store", "nowhere"))) == ""
    assert fault_of(commands.run(tmp_path, (f"{CARELESS}nothing", "nowhere"))).startswith("a traceback: AttributeError")


def test_trees_differ_in_names_and_contents_and_not_in_clocks(tmp_path: Path) -> None:
    for name, seconds in (("one", 1.5), ("two", 2.5)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "metrics.jsonl").write_text(f'{{"step": 1, "seconds": {seconds}}}\n')
    one = tree(tmp_path / "one")
    assert difference(tree(tmp_path / "two"), one) == ""
    (tmp_path / "two" / "metrics.jsonl").write_text('{"step": 2, "seconds": 2.5}\n')
    (tmp_path / "two" / ".model.tmp").touch()
    assert difference(tree(tmp_path / "two"), one) == "left over: .model.tmp; different: metrics.jsonl"


def test_nothing_is_lost_by_kills(commands: Commands, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A slice of `python -m benchmarks.trust crash`."""
    monkeypatch.setattr(crash, "Commands", lambda: nullcontext(commands))
    assert set(SLICE) <= set(SCENARIOS)
    report = crash.run(0, math.inf, tmp_path, SLICE, NUM_FAULTS)
    assert report.failures == ()
    assert report.tried == NUM_FAULTS * len(SLICE)
