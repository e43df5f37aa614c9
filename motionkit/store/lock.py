"""Locks between processes: they end with the process that holds them, however it ends."""

import errno
import fcntl
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from motionkit.core.errors import StoreError
from motionkit.core.files import naming, require_no_link

LOCK_FILE = ".writer.lock"
HOLDER_BYTES = 300


@contextmanager
def exclusive_lock(path: Path, *, busy: str | None) -> Iterator[None]:
    """Hold an exclusive lock on a file for as long as the block runs; the file is made where it is missing.

    With `busy`, a lock that is held elsewhere raises `StoreError` with that text and the holder's name; without, it is
    waited for. Raises `LinkError` for a symbolic link.
    """
    require_no_link(path, "delete the link")
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
    try:
        with naming(path):
            _lock(descriptor, busy)
            os.ftruncate(descriptor, 0)
            os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
        yield
    finally:
        os.close(descriptor)


def _lock(descriptor: int, busy: str | None) -> None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (fcntl.LOCK_NB if busy is not None else 0))
    except OSError as error:
        if error.errno not in (errno.EAGAIN, errno.EACCES):
            raise
        holder = os.read(descriptor, HOLDER_BYTES).decode("utf-8", "replace").strip()
        raise StoreError(f"{busy} (held by {holder or 'an unknown process'})") from None
