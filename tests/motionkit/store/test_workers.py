"""Calls in processes and on a local Ray: order, dead workers, and the same store, byte for byte, from all of them."""

import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from motionkit.core.errors import MissingExtraError, MotionkitError, UsageError
from motionkit.store import Store, chunks, workers
from motionkit.store.ingest import ingest
from motionkit.store.workers import CALLS_IN_FLIGHT_PER_WORKER, WorkerDied, Workers, check_engine, start_workers
from tests.helpers.small_bvh import two_joints_bvh


@pytest.fixture(scope="module", params=["this process", "processes", "ray"])
def started(request: pytest.FixtureRequest) -> Iterator[Workers]:
    engine, number = {"this process": ("local", 1), "processes": ("local", 2), "ray": ("ray", 2)}[request.param]
    with start_workers(engine, number) as running:
        yield running


def ten_times(number: int) -> int:
    return 10 * number


@dataclass
class DieOf:
    """Multiplies by ten, and ends its process for 5: once if there is a marker, as where it is killed from outside."""

    marker: Path | None

    def __call__(self, number: int) -> int:
        if number == 5 and not (self.marker is not None and self.marker.exists()):
            if self.marker is not None:
                self.marker.touch()
            os._exit(1)
        return 10 * number


def refuse(number: int) -> int:
    raise OSError(28, "No space left on device", "part.new")


def test_outputs_come_in_order_and_few_calls_are_in_flight(started: Workers) -> None:
    submitted = []

    def numbers() -> Iterator[int]:
        for number in range(60):
            submitted.append(number)
            yield number

    results = started.map(ten_times, numbers())
    first = [next(results) for _ in range(10)]
    assert len(submitted) <= 10 + CALLS_IN_FLIGHT_PER_WORKER * started.num_workers
    assert [*first, *results] == [(number, 10 * number) for number in range(60)]


@pytest.mark.parametrize("once", [True, False])
def test_a_call_whose_worker_died_is_tried_once_more_and_costs_no_other(
    started: Workers, tmp_path: Path, once: bool
) -> None:
    if started.num_workers == 1:
        pytest.skip("would end this process")
    results = dict(started.map(DieOf(tmp_path / "marker" if once else None), range(20)))
    assert isinstance(results.pop(5), int if once else WorkerDied)
    assert results == {number: 10 * number for number in range(20) if number != 5}


@pytest.mark.parametrize(("engine", "number"), [("local", 1), ("local", 2), ("ray", 2)])
def test_what_a_worker_raises_is_raised(engine: str, number: int) -> None:
    with pytest.raises(OSError, match=r"No space left .*part\.new"), start_workers(engine, number) as running:
        list(running.map(refuse, [0]))


STUCK = """
import time
from motionkit.store.workers import start_workers

def sleep(value):
    print("asleep", flush=True)
    time.sleep(3600)

if __name__ == "__main__":
    with start_workers("local", 2) as workers:
        workers.submit(sleep, 0)
        input()
        raise KeyboardInterrupt
"""


def test_what_a_worker_is_at_is_not_waited_for(tmp_path: Path) -> None:
    program = tmp_path / "stuck.py"
    program.write_text(STUCK)
    process = subprocess.Popen(
        [sys.executable, program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout is not None and process.stdout.readline() == b"asleep\n"
    _, stderr = process.communicate(b"\n", timeout=60)
    assert process.returncode != 0 and stderr.splitlines()[-1] == b"KeyboardInterrupt"


def test_the_store_does_not_depend_on_the_engine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "captures"
    folder.mkdir()
    for number in range(70):
        rows = [f"{frame} 90 0 {number} 0 {frame / 7:.6f} 0 {frame} 0" for frame in range(1, 20 + 9 * number)]
        text = two_joints_bvh(rows)
        (folder / f"walk-{number:02d}.bvh").write_text(text if number % 20 != 13 else text[:-200])
    monkeypatch.setattr(chunks, "CHUNK_BYTES", 2**16)
    reports = {
        name: ingest([folder], tmp_path / name, engine=engine, num_workers=number)
        for name, engine, number in (("alone", "local", 1), ("local", "local", 2), ("ray", "ray", 2))
    }
    assert {report.num_stored for report in reports.values()} == {67}
    assert len({tuple(map(str, report.problems)) for report in reports.values()}) == 1
    assert len({(tmp_path / name / "manifest.json").read_bytes() for name in reports}) == 1
    assert len(Store.open(tmp_path / "ray").manifest.parts) > 3


def test_workers_of_another_version_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "__version__", "0.0.1")
    with pytest.raises(MotionkitError, match=r"this is 0\.0\.1"), start_workers("ray", 1) as running:
        running.call(ten_times, 1)


def test_without_ray(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingExtraError, match=r"pip install '\.\[ray\]'"), start_workers("ray", 2):
        pass


@pytest.mark.parametrize("name", ["dask", "ray:", "ray://", "ray://host", "ray://:10001", "ray://host:port"])
def test_unknown_engines(name: str) -> None:
    with pytest.raises(UsageError, match="expected local, ray"):
        check_engine(name)
