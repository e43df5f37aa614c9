"""Files that appear whole or not at all, the writer's lock."""

import errno
import fcntl
import os
import socket
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from motionkit.errors import StoreError

LOCK_FILE = ".writer.lock"


def sync_file(path: Path) -> None:
    """Flush a file's content to the disk."""
    with path.open("rb") as handle:
        os.fsync(handle.fileno())


def sync_folder(path: Path) -> None:
    """Flush a folder's entries to the disk, so that a rename survives a power cut."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def replace(source: Path, target: Path) -> None:
    """Rename atomically within one folder, replacing what was there; both content and name are flushed."""
    sync_file(source)
    source.replace(target)
    sync_folder(target.parent)


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


@contextmanager
def exclusive_lock(path: Path, *, busy: str | None) -> Iterator[None]:
    """Hold an exclusive lock on a file for as long as the block runs; it ends with the process, however that ends.

    With `busy`, a lock that is held elsewhere raises `StoreError` with that text and the holder's name; without, it is
    waited for.
    """
    with path.open("a+", encoding="utf-8") as handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | (fcntl.LOCK_NB if busy is not None else 0))
        except OSError as error:
            if error.errno not in (errno.EAGAIN, errno.EACCES):
                raise
            handle.seek(0)
            raise StoreError(f"{busy} (held by {handle.read().strip() or 'an unknown process'})") from None
        handle.truncate(0)
        handle.write(f"process {os.getpid()} on {socket.gethostname()}\n")
        handle.flush()
        yield
