"""A map over processes: order, and what happens when one of them dies."""

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from motionkit.errors import FormatError, MotionkitError
from motionkit.formats.items import ReadOptions, SourceItem
from motionkit.store.read_batch import read_batch
from motionkit.workers.parallel import BATCHES_IN_FLIGHT_PER_WORKER, WorkerDied, map_in_order
from motionkit.workers.process_engine import Processes, ThisProcess


def ten_times(numbers: Sequence[int]) -> list[int]:
    return [10 * number for number in numbers]


def ten_times_but_die_of_five(numbers: Sequence[int]) -> list[int]:
    if 5 in numbers:
        os._exit(1)
    return ten_times(numbers)


def die(numbers: Sequence[int]) -> list[int]:
    os._exit(1)


BATCHES = [[0], [1, 2], [3, 4, 5, 6], *([number] for number in range(7, 40))]


@pytest.mark.parametrize("engine", [ThisProcess(), Processes(2)])
def test_results_come_in_order(engine: ThisProcess | Processes) -> None:
    with engine:
        assert list(map_in_order(engine, ten_times, BATCHES)) == [(n, 10 * n) for n in range(40)]


def test_the_input_that_a_worker_dies_of_is_named_and_the_others_are_computed() -> None:
    with Processes(2) as engine:
        results = dict(map_in_order(engine, ten_times_but_die_of_five, BATCHES))
    assert isinstance(results.pop(5), WorkerDied)
    assert results == {n: 10 * n for n in range(40) if n != 5}


def test_workers_that_die_before_anything_is_done_end_the_map() -> None:
    with Processes(2) as engine, pytest.raises(MotionkitError, match=r"3 workers ended .* at 2\): .*--workers 1 shows"):
        list(map_in_order(engine, die, BATCHES))


def noise(numbers: Sequence[int]) -> list[np.ndarray]:
    return [np.random.default_rng(number).random(number) for number in numbers]


def test_arrays_of_any_size_come_back_while_others_are_on_their_way() -> None:
    # From nothing to more than a slot of the shared memory holds; each is there until the next one is asked for.
    sizes = [0, 1, 700_000, 3, *range(1000, 30_000, 1000), 600_000, 5]
    with Processes(2) as engine:
        batches = [sizes[:3], *([size] for size in sizes[3:])]
        same = [
            (size, np.array_equal(array, *noise([size])))
            for size, array in map_in_order(engine, noise, batches)
            if isinstance(array, np.ndarray)
        ]
    assert same == [(size, True) for size in sizes]


STUCK = """
import time
from motionkit.workers.process_engine import Processes

def sleep(batch):
    print("asleep", flush=True)
    time.sleep(3600)

if __name__ == "__main__":
    with Processes(1) as engine:
        engine.submit(sleep, [0])
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


def test_few_inputs_are_in_flight() -> None:
    taken = []

    def batches() -> object:
        for number in range(1000):
            taken.append(number)
            yield [number]

    with Processes(2) as engine:
        results = map_in_order(engine, ten_times, batches())
        for _ in range(10):
            next(results)
    assert len(taken) <= 10 + BATCHES_IN_FLIGHT_PER_WORKER * 2


def test_a_file_that_a_worker_does_not_see(tmp_path: Path) -> None:
    gone = SourceItem(format="bvh", path=tmp_path / "gone.bvh", root=tmp_path, sequence_id="takes/gone")
    (problem,) = read_batch([gone], ReadOptions())
    assert isinstance(problem, FormatError)
    assert problem.reason == "not-visible"
    assert "there is no such file on" in str(problem)
