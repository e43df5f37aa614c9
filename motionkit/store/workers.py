"""Calls computed by workers, in order: in this process, in local processes, or on a Ray cluster (extra `ray`)."""

import os
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, TypeVar

from motionkit.core import __version__
from motionkit.core.errors import MissingExtraError, MotionkitError, UsageError
from motionkit.core.files import defer_signals

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

Input = TypeVar("Input")
Output = TypeVar("Output")

LOCAL, RAY, RAY_ADDRESS = "local", "ray", "ray://"
CALLS_IN_FLIGHT_PER_WORKER = 3


class WorkerDied(Exception):
    """A worker ended without an exception: killed, out of memory, or crashed in a library."""


def usable_cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass(frozen=True)
class Workers:
    """Running workers: their number, how one of them is given a call, and the exceptions that mean that it died."""

    num_workers: int
    submit: Callable[[Callable[[Any], Any], Any], Future[Any]]
    deaths: tuple[type[BaseException], ...] = ()

    def call(self, function: Callable[[Input], Output], value: Input) -> Output:
        """What the function returns; raises what it raises, and `WorkerDied`."""
        try:
            output: Output = self.submit(function, value).result()
        except self.deaths:
            raise WorkerDied from None
        return output

    def map(
        self,
        function: Callable[[Input], Output],
        values: Iterable[Input],
        after_death: Callable[[Input], Output],
    ) -> Generator[tuple[Input, Output]]:
        """Pairs of a value and its output, in the order of the values; few calls are in flight.

        `after_death` is called for a value whose worker died, perhaps of another call.
        """
        in_flight: deque[tuple[Input, Future[Any]]] = deque()

        def first() -> tuple[Input, Output]:
            value, future = in_flight.popleft()
            try:
                return value, future.result()
            except self.deaths:
                return value, after_death(value)

        for value in values:
            in_flight.append((value, self.submit(function, value)))
            if len(in_flight) >= self.num_workers * CALLS_IN_FLIGHT_PER_WORKER:
                yield first()
        while in_flight:
            yield first()


def check_engine(name: str) -> None:
    """Raises `UsageError` for anything but `local`, `ray` and `ray://HOST:PORT`."""
    host, _, port = name.removeprefix(RAY_ADDRESS).rpartition(":")
    if name not in (LOCAL, RAY) and not (name.startswith(RAY_ADDRESS) and host and port.isdecimal()):
        raise UsageError(f"--engine {name}: expected local, ray (this machine, or RAY_ADDRESS) or ray://HOST:PORT")


def start_workers(
    engine: str, num_workers: int | None = None, preload: Sequence[str] = ()
) -> AbstractContextManager[Workers]:
    """The workers of an engine, for a `with` block: one in this process by default, or all of a Ray cluster.

    Local processes import the modules of `preload` once for all. Raises `MissingExtraError` without Ray,
    `MotionkitError` where Ray cannot be reached.
    """
    if engine != LOCAL:
        return _ray_workers(None if engine == RAY else engine, num_workers)
    if num_workers is None or num_workers == 1:
        return nullcontext(Workers(1, _submit_here))
    return _processes(num_workers, preload)


def _submit_here(function: Callable[[Any], Any], value: Any) -> Future[Any]:
    future: Future[Any] = Future()
    future.set_result(function(value))
    return future


@contextmanager
def _processes(num_workers: int, preload: Sequence[str]) -> Iterator[Workers]:
    """Local processes that end with this one, however it ends; a pool in which one died is replaced by another."""
    from concurrent.futures.process import BrokenProcessPool, ProcessPoolExecutor
    from multiprocessing import Pipe, get_all_start_methods, get_context

    # Where it can be, workers are forked from a small server, not from this process, in which Arrow has threads.
    context = get_context("forkserver" if "forkserver" in get_all_start_methods() else "spawn")
    if context.get_start_method() == "forkserver":
        context.set_forkserver_preload(["__main__", __name__, *preload])
        _start_server()
    watched, kept_open = Pipe(duplex=False)
    pools = [ProcessPoolExecutor(num_workers, context, _end_with_parent, (watched,))]

    def submit(function: Callable[[Any], Any], value: Any) -> Future[Any]:
        # A worker that is just being started when this process gives up would look for semaphores that are gone.
        with defer_signals():
            try:
                return pools[-1].submit(function, value)
            except BrokenProcessPool:
                pools.append(ProcessPoolExecutor(num_workers, context, _end_with_parent, (watched,)))
                return pools[-1].submit(function, value)

    try:
        yield Workers(num_workers, submit, (BrokenProcessPool,))
    finally:
        with defer_signals():
            kept_open.close()  # ends the workers: unfinished calls are not waited for
            pools[-1].shutdown(cancel_futures=True)
            watched.close()


def _start_server() -> None:
    """Start the server of workers so that Ctrl-C, which a terminal sends to all processes, cannot stop its imports."""
    from multiprocessing import forkserver, resource_tracker
    from signal import SIG_BLOCK, SIG_SETMASK, SIGINT, pthread_sigmask

    with defer_signals():
        resource_tracker.ensure_running()  # else it starts with the server, and unblocks signals in between
        before = pthread_sigmask(SIG_BLOCK, [SIGINT])
        try:
            forkserver.ensure_running()
        finally:
            pthread_sigmask(SIG_SETMASK, before)


def _end_with_parent(watched: "Connection") -> None:
    import signal
    import threading
    from multiprocessing import connection, parent_process

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to all processes of a terminal
    parent = parent_process()
    assert parent is not None

    def watch() -> None:
        connection.wait([parent.sentinel, watched])  # readable once the other end is closed, or its process is gone
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _ray_workers(address: str | None, num_workers: int | None) -> Iterator[Workers]:
    """Workers of the Ray at `address` or RAY_ADDRESS, else of one started here; a running connection is kept open.

    They read files of their own machine's file system.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # before Ray is imported: nothing is reported to anyone
    try:
        ray: Any = import_module("ray")
    except ImportError:
        raise MissingExtraError("ray", "ray") from None
    exceptions = ray.exceptions
    deaths = (
        exceptions.WorkerCrashedError,
        exceptions.OutOfMemoryError,
        exceptions.NodeDiedError,
        exceptions.ObjectLostError,
    )
    is_connected = ray.is_initialized()
    starts_one = address is None and "RAY_ADDRESS" not in os.environ
    options = {"num_cpus": num_workers or usable_cores(), "include_dashboard": False} if starts_one else {}
    try:
        if not is_connected:
            ray.init(address, log_to_driver=False, logging_level="ERROR", **options)
    except (OSError, ValueError, RuntimeError) as error:
        where = address or os.environ.get("RAY_ADDRESS", "on this machine")
        reason = next(iter(str(error).splitlines()), type(error).__name__)
        raise MotionkitError(f"Ray cannot be reached at {where} ({reason}): is it running there?") from None
    # Ray's own repetition of a task whose worker died would hide which one it was.
    remote = ray.remote(max_retries=0)(lambda function, value: function(value))
    try:
        number = num_workers or max(1, int(ray.cluster_resources().get("CPU", 1)))
        yield Workers(number, lambda function, value: remote.remote(function, value).future(), deaths)
    except exceptions.RayError as error:
        cause = getattr(error, "cause", None)
        if isinstance(cause, (MotionkitError, OSError)):
            raise cause from None
        reason = str(error).strip().splitlines()[-1]
        message = f"a worker of Ray failed ({reason}): motionkit {__version__} must be installed where it runs"
        raise MotionkitError(message) from None
    finally:
        if not is_connected:
            ray.shutdown()
