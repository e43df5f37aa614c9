"""Waiting for the disk in a thread, while the next bytes are computed."""

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor


class Flushing:
    """Waits for the disk in a thread of its own, one piece of work after the other, while its owner goes on writing.

    What fails there is raised here: by the next `begin`, or at the latest by `settle`.
    """

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, "flushing")
        self._under_way: deque[Future[None]] = deque()

    def begin(self, work: Callable[[], None]) -> None:
        """Have something done behind all that was begun before."""
        while self._under_way and self._under_way[0].done():
            self._under_way.popleft().result()
        self._under_way.append(self._thread.submit(work))

    def settle(self) -> None:
        """Wait until all is done."""
        while self._under_way:
            self._under_way.popleft().result()

    def close(self) -> None:
        """Let go of what has not been done, whatever has failed."""
        self._thread.shutdown(cancel_futures=True)
