"""Fault injection into a process: killed before a file operation, at a byte of a file, at a moment …

Faults are raised by the process itself (`install`) or from outside, after some seconds (`Fault.signal`).
"""

import os
import resource
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# Audit events of Python's own file operations (PEP 578); writes of C++ libraries raise none, see `bytes`. The positions
# of the path and of its folder's descriptor among an event's arguments.
CHANGING_EVENTS: dict[str, tuple[int, int | None]] = {
    "os.rename": (0, 2),
    "os.remove": (0, 1),
    "os.rmdir": (0, 1),
    "os.mkdir": (0, 2),
    "os.chmod": (0, 2),
    "os.link": (1, 3),
    "os.symlink": (1, 2),
    "os.truncate": (0, None),
}
SIGNALS = {"moment": signal.SIGKILL, "interrupt": signal.SIGINT, "terminate": signal.SIGTERM}
WRITING_FLAGS = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND


@dataclass(frozen=True)
class Fault:
    """One fault of one process.

    Kinds: `none`; `operation`, SIGKILL before the n-th change of a file (n from 0); `bytes`, a kill as soon as any file
    would grow beyond n bytes, so that it is cut there; `limit`, the same as an error (EFBIG) that the command can
    report; `moment`, SIGKILL after n seconds; `worker`, the same to one of its worker processes; `interrupt`, Ctrl-C
    after n seconds, to the process and its workers; `terminate`, SIGTERM after n seconds. Of the disk
    (`disk.SmallDisk`): `full` but for n bytes, and `read-only`.
    """

    kind: str = "none"
    number: float = 0.0

    def __str__(self) -> str:
        descriptions = {
            "none": "undisturbed",
            "operation": f"killed before file operation {self.number:.0f}",
            "bytes": f"killed when a file would be longer than {self.number:.0f} bytes",
            "limit": f"no file may be longer than {self.number:.0f} bytes",
            "moment": f"killed after {self.number:.3f} s",
            "worker": f"a worker killed after {self.number:.3f} s",
            "interrupt": f"Ctrl-C after {self.number:.3f} s",
            "terminate": f"SIGTERM after {self.number:.3f} s",
            "full": f"a disk with {self.number:.0f} bytes free",
            "read-only": "a read-only disk",
        }
        return descriptions[self.kind]

    @property
    def seconds(self) -> float | None:
        """When a signal is to be sent from outside; None for faults that the process makes itself."""
        return self.number if self.kind in SIGNALS or self.kind == "worker" else None


UNDISTURBED = Fault()


def install(fault: Fault, folder: Path) -> list[str]:
    """Arm a fault in this process; returns the list to which each file operation beneath the folder is added."""
    operations: list[str] = []
    if fault.kind in ("bytes", "limit"):
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_FSIZE, (int(fault.number), int(fault.number)))
        signal.signal(signal.SIGXFSZ, signal.SIG_DFL if fault.kind == "bytes" else signal.SIG_IGN)
    fatal = int(fault.number) if fault.kind == "operation" else None

    def note(event: str, name: str) -> None:
        if len(operations) == fatal:
            os.kill(os.getpid(), signal.SIGKILL)
        operations.append(f"{event} {name}")

    _watch(folder.resolve(), note)
    return operations


def _watch(folder: Path, note: Callable[[str, str], None]) -> None:
    """Call `note` before every change of a file beneath a folder, and before every flush to the disk."""
    root, sync = f"{folder}/", os.fsync

    def inside(path: Any, start: int = -1) -> str | None:
        if isinstance(path, int):
            name = str(Path(f"/proc/self/fd/{path}").readlink())
        elif start >= 0:
            name = str(Path(f"/proc/self/fd/{start}").readlink() / os.fsdecode(path))
        else:
            name = os.path.abspath(os.fsdecode(path))  # noqa: PTH100  links are not followed
        return name.removeprefix(root) if name.startswith(root) else None

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        name = None
        if event == "open":
            path, _, flags = arguments
            if isinstance(flags, int) and flags & WRITING_FLAGS and not isinstance(path, int):
                name = inside(path)
        elif event in CHANGING_EVENTS:
            path, start = CHANGING_EVENTS[event]
            name = inside(arguments[path], -1 if start is None else arguments[start])
        if name is not None:
            note(event, name)

    def watched_sync(descriptor: Any) -> None:
        name = inside(descriptor if isinstance(descriptor, int) else descriptor.fileno())
        if name is not None:
            note("os.fsync", name)
        sync(descriptor)

    os.fsync = watched_sync
    sys.addaudithook(hook)
