"""The drill's fuzz: what a reader does wrong is found and named, an input is made again, ours do nothing wrong."""

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from benchmarks.trust import fuzz
from benchmarks.trust.fuzz import workers
from benchmarks.trust.fuzz.mutate import generator, mutate
from benchmarks.trust.fuzz.target import Target
from benchmarks.trust.fuzz.targets import all_targets
from motionkit.core.errors import MotionkitError

# `MOTIONKIT_FUZZ_INPUTS=2000 pytest tests/benchmarks/test_trust_fuzz.py` hunts for longer.
INPUTS_EACH = int(os.environ.get("MOTIONKIT_FUZZ_INPUTS", "20"))
READERS = [target for target in all_targets() if target.name != "result"]


def write(folder: Path) -> None:
    (folder / "take.txt").write_text("1 2 3\n")


def use_text(of: Callable[[str], None]) -> Callable[[Path], None]:
    """A reader that does this with what the file holds, unless nothing has happened to it."""

    def use(folder: Path) -> None:
        text = (folder / "take.txt").read_bytes().decode("latin-1")
        if text != "1 2 3\n":
            of(text)

    return use


def refuse(text: str) -> None:
    raise MotionkitError(f"take.txt: {text[:9]!r}")


def crash(text: str) -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def spend_time(text: str) -> None:
    while True:
        time.process_time()


def sleep(text: str) -> None:
    time.sleep(600)


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        (lambda text: int("x"), "ValueError: invalid literal"),
        (lambda text: np.ones(1 << 28).sum(), "MemoryError"),
        (lambda text: np.float32(1e30) * np.float32(1e30), "RuntimeWarning: overflow"),
        (crash, "ended by SIGSEGV"),
        (spend_time, "more than 0.1 s of processor time"),
        (sleep, "ended by SIGKILL"),
    ],
)
def test_each_fault_is_found_and_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wrong: Callable[[str], object], told: str
) -> None:
    monkeypatch.setattr(workers, "MOST_SECONDS", 0.1)
    if wrong is sleep:
        monkeypatch.setattr(workers, "STUCK_SECONDS", 0.3)
    target = Target("wrong", (write,), use_text(lambda text: wrong(text)))
    [case] = fuzz.run_inputs([target], 5, 3, tmp_path).cases
    assert case.tried == 3
    assert case.failures
    assert all(failure.startswith("wrong:5:") and told in failure for failure in case.failures)


def test_what_is_refused_or_read_is_no_fault(tmp_path: Path) -> None:
    targets = [Target("refuses", (write,), use_text(refuse)), Target("reads", (write,), use_text(len))]
    refused, read = fuzz.run_inputs(targets, 0, 30, tmp_path).cases
    assert (refused.tried, refused.failures, read.tried, read.failures) == (30, (), 30, ())
    assert refused.figures["refused"] > 20
    assert read.figures["read"] == 30


def test_a_source_that_is_not_valid_ends_the_drill(tmp_path: Path) -> None:
    with pytest.raises(MotionkitError):
        fuzz.run_inputs([Target("never", (write,), lambda folder: refuse(""))], 0, 1, tmp_path)


def test_an_input_is_made_again_and_the_source_is_left_as_it_was(tmp_path: Path) -> None:
    for target in all_targets():
        folder = tmp_path / target.name
        folder.mkdir()
        target.makes[0](folder)
        for path in target.victims(folder):
            content = path.read_bytes()
            first, again = (mutate(generator(target.name, 1, 7), path.name, content) for _ in range(2))
            assert first == again
            break
    seen: list[bytes] = []
    target = Target("reads", (write,), lambda folder: seen.append((folder / "take.txt").read_bytes()))
    workers.prepare([target], tmp_path)
    for _ in range(2):
        with workers.damaged_source(target, 3, 4, tmp_path / "reads") as place:
            target.use(place)
    assert seen[1] == seen[2] != seen[0] == (tmp_path / "reads" / "source-0" / "take.txt").read_bytes()


@pytest.mark.parametrize("target", READERS, ids=lambda target: target.name)
def test_every_reader_explains_what_is_wrong(tmp_path: Path, target: Target) -> None:
    """A slice of `python -m benchmarks.trust fuzz`."""
    report = fuzz.run_inputs([target], 0, INPUTS_EACH, tmp_path)
    assert report.tried == INPUTS_EACH
    assert report.failures == ()
