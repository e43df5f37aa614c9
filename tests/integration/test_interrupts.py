"""Ctrl-C and SIGTERM: one line, exit code 130, and nothing left behind, whenever they come."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

import motionkit as mk
from motionkit.cli import app
from tests.helpers.format_samples import bvh_text
from tests.helpers.outcome import Outcome

STOPPED = "motionkit: stopped\n"
# What the installed script does; it says when a signal would no longer meet Python alone.
SCRIPT = """
import sys
from motionkit.cli import app

prepare = app.stop_by_signals
app.stop_by_signals = lambda: (prepare(), print("begun", flush=True))
sys.exit(app.main())
"""
NUM_TAKES = 24


@pytest.fixture(autouse=True)
def same_handlers() -> Iterator[None]:
    """`app.main` is for a process of its own: it changes what signals do."""
    previous = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in previous.items():
        signal.signal(number, handler)


def interrupted(*arguments: object) -> None:
    """What Ctrl-C raises."""
    raise KeyboardInterrupt


def test_an_interrupted_command_says_so(motionkit, tmp_path, monkeypatch):
    monkeypatch.setattr("motionkit.store.Store.open", interrupted)
    outcome = motionkit("info", "--store", tmp_path)
    assert (outcome.code, outcome.stdout, outcome.stderr) == (130, "", STOPPED)


@pytest.mark.parametrize("raised", [KeyboardInterrupt, RuntimeError, mk.MotionkitError, mk.UsageError])
def test_so_does_one_that_is_being_loaded(raised, monkeypatch, capsys):
    def loading(only: str = "") -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise raised from None  # a library may turn one into the other

    monkeypatch.setattr(app, "build_app", loading)
    monkeypatch.setattr(app, "_received", [])
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)
    with pytest.raises(SystemExit) as ended:
        app.main()
    assert ended.value.code == 130 and capsys.readouterr().err == STOPPED


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files that two workers read while the command writes what they have read."""
    folder = tmp_path_factory.mktemp("corpus")
    for number in range(NUM_TAKES):
        (folder / f"take-{number:02}.bvh").write_text(bvh_text(1000 + number))
    return folder


@pytest.fixture(scope="module")
def seconds_of_all(corpus: Path, tmp_path_factory: pytest.TempPathFactory) -> float:
    """How long the command takes that no signal stops."""
    folder = tmp_path_factory.mktemp("whole")
    outcome, seconds = run(ingest_of(corpus, folder / "store"), folder)
    assert (outcome.code, outcome.stderr) == (0, "")
    return seconds


@pytest.fixture
def temporary() -> Iterator[Path]:
    """A folder for temporary files whose path is short: a socket's may have 107 bytes."""
    with tempfile.TemporaryDirectory(dir="/tmp") as folder:
        yield Path(folder)


@pytest.mark.parametrize(
    ("number", "num_moments", "to_group"), [(signal.SIGINT, 3, True), (signal.SIGTERM, 2, False)], ids=["INT", "TERM"]
)
def test_whenever_it_comes_the_store_stays_and_nothing_is_left(
    corpus: Path,
    seconds_of_all: float,
    temporary: Path,
    tmp_path: Path,
    number: signal.Signals,
    num_moments: int,
    to_group: bool,
) -> None:
    store = tmp_path / "store"
    assert run(ingest_of(corpus / "take-00.bvh", store), temporary)[0].code == 0
    before = contents(store)
    for moment in range(num_moments):
        after = seconds_of_all * moment / num_moments
        outcome, _ = run(ingest_of(corpus, store), temporary, number, after, to_group)
        assert list(temporary.rglob("*")) == [], moment
        if outcome.code == 0:  # this time it was faster
            assert outcome.stderr == ""
        else:
            assert (outcome.code, outcome.stdout, outcome.stderr) == (130, "begun\n", STOPPED), moment
        if contents(store) != before:  # one that comes with the commit comes too late
            assert len(mk.Store.open(store).sequences) == NUM_TAKES
            break


def ingest_of(source: Path, store: Path) -> list[str]:
    return ["ingest", str(source), "--store", str(store), "--workers", "2"]


def run(
    arguments: list[str], temporary: Path, number: signal.Signals | None = None, after: float = 0, to_group: bool = True
) -> tuple[Outcome, float]:
    """Run the command, which may be sent a signal after some seconds, with or without all processes that it started.

    All its processes have ended when this returns: what the command left behind, and how many seconds it took.
    """
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT, *arguments],
        env=os.environ | {"TMPDIR": str(temporary)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        assert process.stdout is not None
        begun, start = process.stdout.readline(), time.monotonic()
        if number is not None:
            time.sleep(after)
            if process.poll() is None:
                (os.killpg if to_group else os.kill)(process.pid, number)
        stdout, stderr = process.communicate(timeout=60)
        seconds = time.monotonic() - start
        wait_for_group(process.pid)
    finally:
        for left in processes_of(process.pid):
            os.kill(left, signal.SIGKILL)
    return Outcome(process.returncode, begun + stdout, stderr), seconds


def wait_for_group(group: int) -> None:
    """Until no process of it is left; the server of workers sees a moment later that its parent is gone."""
    deadline = time.monotonic() + 10
    while left := processes_of(group):
        assert time.monotonic() < deadline, f"{left} of the command are still there"
        time.sleep(0.01)


def processes_of(group: int) -> list[int]:
    """The running processes of a group; those that have ended may wait to be collected."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            state, _, of_group, *_ = path.read_text().rpartition(")")[2].split()
            found += [int(path.parent.name)] * (int(of_group) == group and state != "Z")
    return found


def contents(store: Path) -> dict[str, bytes]:
    """All files of a store, but for the lock."""
    return {
        str(path.relative_to(store)): path.read_bytes()
        for path in sorted(store.rglob("*"))
        if path.is_file() and path.name != ".writer.lock"
    }
