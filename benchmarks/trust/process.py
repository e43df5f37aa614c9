"""motionkit's commands as processes in which faults happen: killed before a file operation, at a byte, at a moment …"""

import contextlib
import importlib
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

REPOSITORY = Path(__file__).parents[2]
CALL = "call:"
TIMEOUT_SECONDS, PATIENCE_SECONDS = 180.0, 10.0
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "ARROW_NUM_THREADS")
# Audit events of Python's own file operations (PEP 578), with the positions of the path and of its folder's descriptor
# among their arguments; writes of C++ libraries raise none, see the faults `bytes` and `limit`.
CHANGING_EVENTS: dict[str, tuple[int, int | None]] = {
    **{f"os.{name}": (0, 2) for name in ("rename", "mkdir", "chmod")},
    **{f"os.{name}": (0, 1) for name in ("remove", "rmdir")},
    "os.link": (1, 3),
    "os.symlink": (1, 2),
    "os.truncate": (0, None),
}
SIGNALS = {"moment": signal.SIGKILL, "interrupt": signal.SIGINT, "terminate": signal.SIGTERM}
WRITING_FLAGS = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND


@dataclass(frozen=True)
class Fault:
    """One fault of one process, and its number.

    Kinds: `none`; `operation`, SIGKILL before the n-th change of a file (n from 0); `bytes`, a kill as soon as any file
    would grow beyond n bytes; `limit`, the same as an error (EFBIG) that the command can report; `moment`, SIGKILL
    after n seconds; `interrupt`, Ctrl-C after n seconds, to the process and its workers; `terminate`, SIGTERM after n
    seconds.
    """

    kind: str = "none"
    number: float = 0.0

    def __str__(self) -> str:
        return f"{self.kind} {self.number:g}"


UNDISTURBED = Fault()


@dataclass(frozen=True)
class Outcome:
    """How a process ended: exit code (minus the signal's number, None for a hang), its output, its seconds.

    Seconds count from the command's beginning, after the imports. `is_left` says whether a process that it started was
    still running ten seconds later; `operations` are the changes of files beneath its folder, in order.
    """

    code: int | None
    out: str
    err: str
    seconds: float
    is_left: bool
    operations: tuple[str, ...]

    @property
    def last_line(self) -> str:
        """The last line of stderr."""
        return (self.err.strip().splitlines() or [""])[-1]

    @property
    def shows_traceback(self) -> bool:
        """Whether it printed a traceback."""
        return "Traceback" in self.err or "Exception ignored" in self.err


def run_command(folder: Path, arguments: Sequence[str], fault: Fault = UNDISTURBED) -> Outcome:
    """Run `motionkit ARGUMENTS` in a folder, or the function that `call:MODULE:NAME` names with the rest of them.

    A training saves a checkpoint after every step.
    """
    # This code, one thread for each library, no settings of a user's.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("MOTIONKIT_")}
    path = [str(REPOSITORY), *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))]
    environment |= dict.fromkeys(ONE_THREAD, "1") | {"PYTHONPATH": os.pathsep.join(path)}
    read, write = os.pipe()
    with tempfile.NamedTemporaryFile() as operations, os.fdopen(read) as notes:
        request = {
            "arguments": list(map(str, arguments)),
            "fault": asdict(fault),
            "operations": operations.name,
            "begun": write,
        }
        process = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.trust.process", json.dumps(request)],
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            pass_fds=(write,),
            start_new_session=True,
        )
        os.close(write)
        notes.read(1)
        begun = time.monotonic()
        timer = threading.Timer(fault.number, _strike, (process, fault))
        if fault.kind in SIGNALS:
            timer.start()
        code: int | None
        try:
            out, err = process.communicate(timeout=TIMEOUT_SECONDS)
            code = process.returncode
        except subprocess.TimeoutExpired:
            process.kill()
            (out, err), code = process.communicate(), None
        seconds = time.monotonic() - begun
        timer.cancel()
        is_left = _outlived(process.pid)
        names = tuple(Path(operations.name).read_text("utf-8").splitlines())
    return Outcome(code, out, err, seconds, is_left, names)


def _strike(process: "subprocess.Popen[str]", fault: Fault) -> None:
    with contextlib.suppress(ProcessLookupError):
        (os.killpg if fault.kind == "interrupt" else os.kill)(process.pid, SIGNALS[fault.kind])


def _outlived(group: int) -> bool:
    """Whether a process of this group outlives its leader by ten seconds; it is then killed."""
    until = time.monotonic() + PATIENCE_SECONDS
    with contextlib.suppress(ProcessLookupError):
        while time.monotonic() < until:
            os.killpg(group, 0)
            time.sleep(0.01)
        os.killpg(group, signal.SIGKILL)
        return True
    return False


def main() -> None:
    """In the child: arm the fault, and run the command as the installed script does."""
    request = json.loads(sys.argv[1])
    from motionkit.cli.app import main as app

    if request["arguments"][0] == "train":
        from motionkit.training.loop import train_loop

        assert train_loop.__kwdefaults__ is not None
        train_loop.__kwdefaults__["checkpoint_seconds"] = 0.0
    _install(Fault(**request["fault"]), Path.cwd(), os.open(request["operations"], os.O_WRONLY))
    os.close(request["begun"])
    first, *rest = request["arguments"]
    if not first.startswith(CALL):
        sys.argv = ["motionkit", first, *rest]
        app()
        return
    from motionkit.core.errors import MotionkitError

    module, _, name = first.removeprefix(CALL).partition(":")
    try:
        getattr(importlib.import_module(module), name)(*rest)
    except (MotionkitError, OSError) as error:  # as the app tells them
        sys.exit(f"motionkit: {error}")


def _install(fault: Fault, folder: Path, operations: int) -> None:
    """Arm a fault in this process; each file operation beneath the folder is written to a descriptor."""
    if fault.kind in ("bytes", "limit"):
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_FSIZE, (int(fault.number), int(fault.number)))
        signal.signal(signal.SIGXFSZ, signal.SIG_DFL if fault.kind == "bytes" else signal.SIG_IGN)
    left = [int(fault.number)] if fault.kind == "operation" else []

    def note(event: str, name: str) -> None:
        if left == [0]:
            os.kill(os.getpid(), signal.SIGKILL)
        left[:] = [number - 1 for number in left]
        if fault == UNDISTURBED:
            os.write(operations, f"{event} {name}\n".encode())

    _watch(folder.resolve(), note)


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


if __name__ == "__main__":
    main()
