"""An ordered parallel map that identifies inputs which crash a worker."""

import os
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

from motionkit.core.errors import MotionkitError

Input = TypeVar("Input")
Output = TypeVar("Output")
Function = Callable[[Sequence[Any]], Any]

BATCHES_IN_FLIGHT_PER_WORKER = 3
# After this many consecutive deaths before any result, the cause is not the inputs.
DEATHS_AT_START = 3


class WorkerDied(Exception):
    """A worker died without an exception: killed, out of memory, or crashed in a library."""


@runtime_checkable
class Engine(Protocol):
    """Workers that compute batches; a context manager that starts and stops them.

    `submit` does not block, `result` waits for a batch and raises `WorkerDied` if its worker died; a batch may be
    submitted again after that.
    """

    num_workers: int

    def __enter__(self) -> "Engine": ...

    def __exit__(self, *exception: object) -> None: ...

    def submit(self, function: Callable[[Sequence[Any]], Any], batch: Sequence[Any]) -> object:
        """Start computing a batch; the ticket is what `result` takes."""
        ...

    def result(self, ticket: Any) -> Any:
        """What the function returned for a batch; raises what it raised."""
        ...


def usable_cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class ThisProcess:
    """One worker in this process: a batch is computed when its result is requested."""

    num_workers = 1

    def __enter__(self) -> "ThisProcess":
        return self

    def __exit__(self, *exception: object) -> None:
        pass

    def submit(self, function: Function, batch: Sequence[Any]) -> tuple[Function, Sequence[Any]]:
        """Store the batch."""
        return function, batch

    def result(self, ticket: tuple[Function, Sequence[Any]]) -> Any:
        """Compute it."""
        function, batch = ticket
        return function(batch)


def map_in_order(
    engine: Engine, function: Callable[[Sequence[Input]], Output], batches: Iterable[Sequence[Input]]
) -> Generator[tuple[Sequence[Input], Output | WorkerDied]]:
    """Pairs (batch, output) in the order of the batches.

    At most three batches per worker are in flight. A batch whose worker died is retried alone; if that fails too, it is
    bisected: an input that crashes its worker alone has `WorkerDied` as its output. Raises `MotionkitError` if workers
    die before any result.
    """
    yield from _Map(engine, function).run(batches)


class _Map(Generic[Input, Output]):
    """Owns the batches in flight, oldest first."""

    def __init__(self, engine: Engine, function: Callable[[Sequence[Input]], Output]) -> None:
        self._engine = engine
        self._function = function
        self._in_flight: deque[tuple[Sequence[Input], object]] = deque()
        self._deaths_at_start: int | None = 0

    def run(self, batches: Iterable[Sequence[Input]]) -> Iterator[tuple[Sequence[Input], Output | WorkerDied]]:
        """Keep the engine's workers busy and yield results in order."""
        for batch in batches:
            self._in_flight.append((batch, self._engine.submit(self._function, batch)))
            if len(self._in_flight) >= self._engine.num_workers * BATCHES_IN_FLIGHT_PER_WORKER:
                yield from self._oldest()
        while self._in_flight:
            yield from self._oldest()

    def _oldest(self) -> Iterator[tuple[Sequence[Input], Output | WorkerDied]]:
        batch, ticket = self._in_flight.popleft()
        try:
            output = self._engine.result(ticket)
        except WorkerDied:
            yield from self._again(batch)
            # Other batches may have died with it; nothing else runs beside a suspect input.
            while self._in_flight:
                yield from self._oldest()
            return
        self._deaths_at_start = None
        yield batch, output

    def _again(self, batch: Sequence[Input]) -> Iterator[tuple[Sequence[Input], Output | WorkerDied]]:
        try:
            output = self._engine.result(self._engine.submit(self._function, batch))
        except WorkerDied as died:
            if len(batch) > 1:
                for half in (batch[: len(batch) // 2], batch[len(batch) // 2 :]):
                    yield from self._again(half)
                return
            if self._deaths_at_start is not None:
                self._deaths_at_start += 1
                if self._deaths_at_start == DEATHS_AT_START:
                    raise MotionkitError(
                        f"{DEATHS_AT_START} workers ended before they had done anything (the last one at {batch[0]}): "
                        "killed, or out of memory? --workers 1 shows where"
                    ) from None
            yield batch, died
            return
        self._deaths_at_start = None
        yield batch, output
