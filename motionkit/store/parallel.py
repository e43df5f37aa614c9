"""A map over many inputs by processes: results in order, bounded memory, no orphans."""

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait
from typing import TypeVar

from motionkit.errors import MotionkitError

Input = TypeVar("Input")
Output = TypeVar("Output")

INPUTS_IN_FLIGHT_PER_WORKER = 3


def usable_cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def map_in_order(
    function: Callable[[Input], Output], inputs: Iterable[Input], num_workers: int
) -> Generator[tuple[Input, Output]]:
    """Pairs (input, function(input)) in the order of the inputs, computed by `num_workers` processes.

    At most three inputs per worker are in flight, so memory does not grow with the number of inputs. With one worker
    everything happens in this process. Workers are spawned, not forked (Arrow has threads), and end with this process,
    also where it is killed. Raises `MotionkitError` where a worker dies, naming the input that it may have died of.
    """
    if num_workers <= 1:
        for each in inputs:
            yield each, function(each)
        return
    context = multiprocessing.get_context("spawn")
    pending: deque[tuple[Input, Future[Output]]] = deque()
    with ProcessPoolExecutor(num_workers, mp_context=context, initializer=_start_worker) as pool:
        try:
            for each in inputs:
                pending.append((each, _submit(pool, function, each)))
                if len(pending) >= num_workers * INPUTS_IN_FLIGHT_PER_WORKER:
                    yield _first(pending)
            while pending:
                yield _first(pending)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _submit(pool: ProcessPoolExecutor, function: Callable[[Input], Output], each: Input) -> "Future[Output]":
    try:
        return pool.submit(function, each)
    except BrokenProcessPool as broken:
        # The worker died of an input before this one, whose turn to be named comes first.
        failed: Future[Output] = Future()
        failed.set_exception(broken)
        return failed


def _first(pending: deque[tuple[Input, "Future[Output]"]]) -> tuple[Input, Output]:
    each, future = pending.popleft()
    try:
        return each, future.result()
    except BrokenProcessPool:
        raise MotionkitError(
            f"a worker process ended without a word while {each} was being read (killed, or out of memory?): "
            "--workers 1 shows where"
        ) from None


def _start_worker() -> None:
    # Ctrl-C is the parent's to handle; a parent that is killed takes its workers with it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
