"""A process that is killed before one of its file operations."""

import multiprocessing
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path

CHANGES = ("os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.truncate")
WRITING = os.O_WRONLY | os.O_RDWR


def killed_before(operation: int, folder: Path, action: Callable[[], object]) -> bool:
    """Run `action` in a process of its own, which is killed before its n-th change of a file below `folder`.

    Returns whether it came so far; otherwise it ran to its end.
    """
    process = multiprocessing.get_context("fork").Process(target=_run, args=(operation, str(folder), action))
    process.start()
    process.join()
    assert process.exitcode in (0, -signal.SIGKILL)
    return process.exitcode != 0


def _run(operation: int, folder: str, action: Callable[[], object]) -> None:
    left = operation

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        nonlocal left
        if event not in CHANGES and not (event == "open" and isinstance(arguments[2], int) and arguments[2] & WRITING):
            return
        # Inside a folder that is deleted, names alone are given.
        place = str(arguments[0])
        if place.startswith(folder) or "/" not in place:
            if not left:
                os.kill(os.getpid(), signal.SIGKILL)
            left -= 1

    sys.addaudithook(hook)
    action()
    sys.stdout.flush()
    os._exit(0)
