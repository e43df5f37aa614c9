"""Work that is done behind the writer's back: its order, and what becomes of its faults."""

import threading
import time

import pytest

from motionkit.store.flushing import Flushing


def failing() -> None:
    raise OSError(28, "No space left on device")


def test_work_is_done_in_order_and_elsewhere() -> None:
    flushing, done, threads = Flushing(), [], set()

    def work(number: int) -> None:
        time.sleep(0.002 * (number % 3))
        done.append(number)
        threads.add(threading.get_ident())

    for number in range(20):
        flushing.begin(lambda number=number: work(number))
    flushing.settle()
    flushing.close()
    assert done == list(range(20))
    assert len(threads - {threading.get_ident()}) == 1


def test_a_fault_is_raised_when_all_is_awaited() -> None:
    flushing, done, may_fail = Flushing(), [], threading.Event()
    flushing.begin(lambda: may_fail.wait() and failing())
    flushing.begin(lambda: done.append("next"))
    may_fail.set()
    with pytest.raises(OSError, match="No space"):
        flushing.settle()
    flushing.settle()
    flushing.close()
    assert done == ["next"]


def test_a_fault_is_raised_before_much_more_is_begun() -> None:
    flushing = Flushing()
    with pytest.raises(OSError, match="No space"):
        for _ in range(1000):
            flushing.begin(failing)
            time.sleep(0.001)
    flushing.close()


def test_what_has_not_been_done_is_let_go() -> None:
    flushing, may_end, done = Flushing(), threading.Event(), []
    flushing.begin(lambda: may_end.wait() and None)
    flushing.begin(lambda: done.append("never"))
    threading.Timer(0.05, may_end.set).start()
    flushing.close()
    assert done == []
