"""Local worker processes."""

import multiprocessing
import os
import signal
import tempfile
import threading
from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import BaseContext
from typing import Any

from motionkit.core.errors import MotionkitError
from motionkit.core.interrupts import defer_signals
from motionkit.store.engines.parallel import Function, WorkerDied


def start_server(preload: Sequence[str] = ()) -> BaseContext:
    """Start the server process that workers are forked from, unless it runs; does not wait.

    It imports the modules of `preload` once in the background: a command that needs workers starts it before its own
    imports. Ctrl-C is handled by this process only: the server and its workers ignore it.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["__main__", __name__, *preload])
    with defer_signals():
        resource_tracker.ensure_running()  # else it starts with the server, and unblocks signals in between
        # What is blocked stays so in the process that is started, from its first moment on. Python has the server
        # ignore Ctrl-C too, but only when everything is loaded, and until then prints a traceback.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        try:
            forkserver.ensure_running()
        except OSError as error:
            if "AF_UNIX" not in str(error):
                raise
            raise MotionkitError(
                f"{tempfile.gettempdir()}: the path is too long for the sockets by which workers are reached. "
                "Set TMPDIR to a folder with a shorter path, or use --workers 1."
            ) from None
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return context


@dataclass(frozen=True)
class _Ticket:
    pool: ProcessPoolExecutor
    future: Future[Any]


class Processes:
    """Local processes that end with this one, however it ends.

    They are forked from a small server (`start_server`), not from this process, where Arrow has threads. A pool with a
    dead process is discarded: the next batch starts another.
    """

    def __init__(self, num_workers: int, preload: Sequence[str] = ()) -> None:
        self.num_workers = num_workers
        self._preload = preload
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> "Processes":
        self._at_work, self._stop = multiprocessing.Pipe(duplex=False)
        return self

    def __exit__(self, *exception: object) -> None:
        with defer_signals():
            self._stop.close()  # do not wait for unfinished work
            if self._pool is not None:
                self._pool.shutdown(cancel_futures=True)
                self._pool = None
            self._at_work.close()

    def submit(self, function: Function, batch: Sequence[Any]) -> _Ticket:
        """Submit a batch to the pool, which is started if needed."""
        # A worker that is just being started when this process gives up would look for semaphores that are gone.
        with defer_signals():
            if self._pool is None:
                self._pool = ProcessPoolExecutor(
                    self.num_workers,
                    mp_context=start_server(self._preload),
                    initializer=_start_worker,
                    initargs=(self._at_work,),
                )
            try:
                future = self._pool.submit(function, batch)
            except BrokenProcessPool as broken:
                future = Future()
                future.set_exception(broken)
        return _Ticket(self._pool, future)

    def result(self, ticket: _Ticket) -> Any:
        """Wait for a batch; raises `WorkerDied` where the pool broke before it was computed."""
        try:
            return ticket.future.result()
        except BrokenProcessPool:
            if self._pool is not None and ticket.pool is self._pool:
                self._pool.shutdown(cancel_futures=True)
                self._pool = None
            raise WorkerDied from None


def _start_worker(at_work: Connection) -> None:
    threading.Thread(target=_end_with_parent, args=(at_work,), daemon=True).start()


def _end_with_parent(at_work: Connection) -> None:
    # A parent that is killed takes its workers with it, and one that gives up closes its end of the pipe.
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel, at_work])
        os._exit(1)
