"""Workers of this machine: this process itself, or others that it starts."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import forkserver
from multiprocessing.connection import wait
from multiprocessing.context import BaseContext
from typing import Any

from motionkit.workers.parallel import WorkerDied

# One server serves all workers of a process, whatever they compute.
PRELOADED = ("motionkit.store.read_batch",)

Function = Callable[[Sequence[Any]], Sequence[Any]]


def usable_cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def start_server() -> BaseContext:
    """Start the process that workers are forked from, unless it runs, and do not wait for it.

    It imports what every worker needs, once, while this process goes on: a command that will need workers starts it
    before its own imports.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["__main__", *PRELOADED])
    forkserver.ensure_running()
    return context


class ThisProcess:
    """One worker, this process: a batch is computed when its result is asked for."""

    num_workers = 1

    def __enter__(self) -> "ThisProcess":
        return self

    def __exit__(self, *exception: object) -> None:
        pass

    def submit(self, function: Function, batch: Sequence[Any]) -> tuple[Function, Sequence[Any]]:
        """Remember what to compute."""
        return function, batch

    def result(self, ticket: tuple[Function, Sequence[Any]]) -> Sequence[Any]:
        """Compute it."""
        function, batch = ticket
        return function(batch)


@dataclass(frozen=True)
class _Ticket:
    pool: ProcessPoolExecutor
    future: "Future[Sequence[Any]]"


class Processes:
    """Processes of this machine; they end with this one, however it ends.

    They are forked from a small server (`start_server`), not from this process, where Arrow has threads. A pool of
    which one process died is of no more use: the next batch starts another.
    """

    def __init__(self, num_workers: int) -> None:
        self.num_workers = num_workers
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> "Processes":
        return self

    def __exit__(self, *exception: object) -> None:
        self._end()

    def submit(self, function: Function, batch: Sequence[Any]) -> _Ticket:
        """Hand a batch to the pool, which is started where there is none."""
        if self._pool is None:
            self._pool = ProcessPoolExecutor(self.num_workers, mp_context=start_server(), initializer=_start_worker)
        try:
            return _Ticket(self._pool, self._pool.submit(function, batch))
        except BrokenProcessPool as broken:
            failed: Future[Sequence[Any]] = Future()
            failed.set_exception(broken)
            return _Ticket(self._pool, failed)

    def result(self, ticket: _Ticket) -> Sequence[Any]:
        """Wait for a batch; raises `WorkerDied` where the pool broke before it was computed."""
        try:
            return ticket.future.result()
        except BrokenProcessPool:
            if ticket.pool is self._pool:
                self._end()
            raise WorkerDied from None

    def _end(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
            self._pool = None


def _start_worker() -> None:
    # Ctrl-C is the parent's to handle; a parent that is killed takes its workers with it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
