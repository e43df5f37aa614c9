"""A map over many inputs by workers: results in order, bounded memory, and the input that a worker dies of is named."""

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

from motionkit.errors import MotionkitError

Input = TypeVar("Input")
Output = TypeVar("Output")

BATCHES_IN_FLIGHT_PER_WORKER = 6
# So many workers in a row that end before one has done anything: it is not the inputs that they die of.
DEATHS_AT_START = 3


class WorkerDied(Exception):
    """A worker ended without a word: killed, out of memory, or crashed in a library."""


@runtime_checkable
class Engine(Protocol):
    """Workers that compute batches; a context manager that starts and ends them.

    `submit` hands a batch over without waiting, `result` waits for it and raises `WorkerDied` where its worker ended; a
    batch may be submitted again after that. `release` says that its outputs are no longer needed.
    """

    num_workers: int

    def __enter__(self) -> "Engine": ...

    def __exit__(self, *exception: object) -> None: ...

    def submit(self, function: Callable[[Sequence[Any]], Sequence[Any]], batch: Sequence[Any]) -> object:
        """Start computing a batch; the ticket is what `result` takes."""
        ...

    def result(self, ticket: Any) -> Sequence[Any]:
        """The outputs of a batch, one for each of its inputs; their arrays are good until the ticket is released."""
        ...

    def release(self, ticket: Any) -> None:
        """Let the memory of a batch's outputs be used again."""
        ...


def map_in_order(
    engine: Engine, function: Callable[[Sequence[Input]], Sequence[Output]], batches: Iterable[Sequence[Input]]
) -> Generator[tuple[Input, Output | WorkerDied]]:
    """Pairs (input, output) in the order of the inputs; `function` gives one output for each input of its batch.

    An output's arrays may lie in memory that is used again: they are good until the next pair is asked for. At most
    six batches per worker are in flight, so memory does not grow with the number of inputs. The inputs of a batch
    whose worker ended are computed again, each alone; that which ends its worker again has `WorkerDied` for its output.
    Raises `MotionkitError` where workers end before any of them has done anything.
    """
    yield from _Map(engine, function).run(batches)


class _Map(Generic[Input, Output]):
    """Owns the batches in flight, oldest first."""

    def __init__(self, engine: Engine, function: Callable[[Sequence[Input]], Sequence[Output]]) -> None:
        self._engine = engine
        self._function = function
        self._in_flight: deque[tuple[Sequence[Input], object]] = deque()
        self._deaths_at_start: int | None = 0

    def run(self, batches: Iterable[Sequence[Input]]) -> Iterator[tuple[Input, Output | WorkerDied]]:
        """Keep the engine's workers busy and hand out what they computed, in order."""
        for batch in batches:
            self._in_flight.append((batch, self._engine.submit(self._function, batch)))
            if len(self._in_flight) >= self._engine.num_workers * BATCHES_IN_FLIGHT_PER_WORKER:
                yield from self._oldest()
        while self._in_flight:
            yield from self._oldest()

    def _oldest(self) -> Iterator[tuple[Input, Output | WorkerDied]]:
        batch, ticket = self._in_flight.popleft()
        try:
            outputs = self._engine.result(ticket)
        except WorkerDied:
            for each in batch:
                yield from self._alone(each)
            # Others may have gone with it, and nothing new may run beside an input that is under suspicion.
            while self._in_flight:
                yield from self._oldest()
            return
        self._deaths_at_start = None
        yield from zip(batch, outputs, strict=True)
        self._engine.release(ticket)

    def _alone(self, each: Input) -> Iterator[tuple[Input, Output | WorkerDied]]:
        ticket = self._engine.submit(self._function, [each])
        try:
            outputs = self._engine.result(ticket)
        except WorkerDied as died:
            if self._deaths_at_start is not None:
                self._deaths_at_start += 1
                if self._deaths_at_start == DEATHS_AT_START:
                    raise MotionkitError(
                        f"{DEATHS_AT_START} workers ended before they had done anything (the last one at {each}): "
                        "killed, or out of memory? --workers 1 shows where"
                    ) from None
            yield each, died
            return
        self._deaths_at_start = None
        yield each, outputs[0]
        self._engine.release(ticket)
