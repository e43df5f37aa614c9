"""A map over processes: order, and what happens when one of them dies."""

import os
import subprocess
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import pytest

from motionkit.core.errors import MotionkitError
from motionkit.store.engines.parallel import BATCHES_IN_FLIGHT_PER_WORKER, ThisProcess, WorkerDied, map_in_order
from motionkit.store.engines.process_engine import Processes


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
        assert list(map_in_order(engine, ten_times, BATCHES)) == [(batch, ten_times(batch)) for batch in BATCHES]


def test_the_input_that_a_worker_dies_of_is_named_and_the_others_are_computed() -> None:
    with Processes(2) as engine:
        results = list(map_in_order(engine, ten_times_but_die_of_five, BATCHES))
    (died,) = (output for batch, output in results if batch == [5])
    assert isinstance(died, WorkerDied)
    # Its batch in halves, and those in halves again, until it is alone.
    assert [batch for batch, _ in results] == [[0], [1, 2], [3, 4], [5], [6], *BATCHES[3:]]
    assert all(output == ten_times(batch) for batch, output in results if batch != [5])


def die_once(marker: str, numbers: Sequence[int]) -> list[int]:
    if 5 in numbers and not Path(marker).exists():
        Path(marker).touch()
        os._exit(1)
    return ten_times(numbers)


def test_a_batch_whose_worker_was_killed_from_outside_stays_whole(tmp_path: Path) -> None:
    with Processes(2) as engine:
        results = list(map_in_order(engine, partial(die_once, str(tmp_path / "marker")), BATCHES))
    assert results == [(batch, ten_times(batch)) for batch in BATCHES]


def test_workers_that_die_before_anything_is_done_end_the_map() -> None:
    with Processes(2) as engine, pytest.raises(MotionkitError, match=r"3 workers ended .* at 2\): .*--workers 1 shows"):
        list(map_in_order(engine, die, BATCHES))


def refuse(numbers: Sequence[int]) -> list[int]:
    raise OSError(28, "No space left on device", "part.new")


@pytest.mark.parametrize("engine", [ThisProcess(), Processes(1)])
def test_what_the_function_raises_is_raised(engine: ThisProcess | Processes) -> None:
    with engine, pytest.raises(OSError, match=r"No space left .*part\.new"):
        list(map_in_order(engine, refuse, BATCHES))


STUCK = """
import time
from motionkit.store.engines.process_engine import Processes

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
