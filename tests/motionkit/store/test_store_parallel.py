"""What happens to a map over processes when one of them dies."""

import multiprocessing
import os
import time

import pytest

from motionkit.errors import MotionkitError
from motionkit.store.parallel import map_in_order


def die_of_five(number: int) -> int:
    if number == 5:
        os._exit(1)
    return 10 * number


def test_results_come_in_order() -> None:
    assert list(map_in_order(die_of_five, range(5), 2)) == [(n, 10 * n) for n in range(5)]


def test_a_worker_that_dies_between_two_results_is_told() -> None:
    results = map_in_order(die_of_five, range(100), 2)
    assert next(results) == (0, 0)
    while multiprocessing.active_children():
        time.sleep(0.01)
    with pytest.raises(MotionkitError, match=r"while [1-5] was being read .*--workers 1 shows where"):
        list(results)
