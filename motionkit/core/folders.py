"""Folders that appear whole or not at all."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from motionkit.core.files import naming, remove_entry, require_no_link, sync
from motionkit.errors import UsageError

LOCK = ".lock"


@contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """Yield an empty folder that becomes `path`, which must be absent or empty, when the block ends without an error.

    It lies in `NAME.partial` beside `path`, with a lock that dies with the process: what a killed writer left is
    deleted by the next one. Raises `UsageError` where another process writes the same folder, or where `NAME.partial`
    is somebody else's, and `LinkError` where it is a link.
    """
    partial = path.with_name(f"{path.name}.partial")
    require_no_link(partial, "delete the link")
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor = _lock(partial)
    content = partial / path.name
    try:
        _remove_content(partial)
        content.mkdir()
        with naming(path):
            yield content
        content.rename(path)
        sync(path.parent)
    finally:
        # Also when stopped by Ctrl-C: nobody would see that it is half a folder. The lock goes last.
        _remove_content(partial)
        with suppress(OSError):
            (partial / LOCK).unlink()
            partial.rmdir()
        os.close(descriptor)


def _lock(partial: Path) -> int:
    """The locked descriptor of the lock's file in `partial`, which is made where it is absent."""
    lock = partial / LOCK
    while True:
        partial.mkdir(exist_ok=True)
        if not lock.exists() and any(partial.iterdir()):
            raise UsageError(f"{partial} exists, and motionkit did not make it: delete it, or name another folder")
        # Another writer that ends at this moment deletes the lock, and the folder.
        with suppress(FileNotFoundError):
            descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if os.path.samestat(os.fstat(descriptor), lock.lstat()):
                    return descriptor
            except BlockingIOError:
                os.close(descriptor)
                raise UsageError(
                    f"{partial} is being written by another process: wait for it, or name another folder"
                ) from None
            except OSError:
                os.close(descriptor)
                raise
            os.close(descriptor)


def _remove_content(partial: Path) -> None:
    for entry in partial.iterdir():
        if entry.name != LOCK:
            remove_entry(entry)
