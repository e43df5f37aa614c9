"""A process that has imported everything and forks one child for each command: `python -m benchmarks.trust.server`.

Reads requests from stdin and answers on stdout, a line of JSON each (see `benchmarks.trust.process`). Python's start
and torch's import would be most of a trial's time. Libraries are imported with one thread each and never used here, so
a fork is safe; modules that a child imports in addition are then imported here for later children.
"""

import atexit
import contextlib
import importlib
import json
import math
import os
import selectors
import signal
import sys
import threading
import time
import traceback
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.trust.faults import SIGNALS, UNDISTURBED, Fault, install
from motionkit.core.errors import MotionkitError

CALL = "call:"
PATIENCE_SECONDS = 10.0
RETRY_SECONDS = 0.005
# A thread of pyarrow's allocator, which stops it before a fork and restarts it afterwards.
SAFE_THREAD = "jemalloc_bg_thd"


def import_everything() -> None:
    """Import every command, and what the commands import late."""
    import torch

    from motionkit.cli.app import build_app
    from motionkit.training.stage import registered_stages

    torch.set_num_threads(1)
    build_app()
    registered_stages()


def require_few_threads() -> None:
    """Raise `RuntimeError` if a library has started threads: a fork would lose them."""
    names = [(thread / "comm").read_text().strip() for thread in Path("/proc/self/task").iterdir()]
    if threading.active_count() > 1 or len(names) > 2 or (len(names) == 2 and SAFE_THREAD not in names):
        raise RuntimeError(f"the server of commands has threads: {sorted(names)}")


@dataclass
class Child:
    """A running command: its process, which leads a process group, and its output."""

    pid: int
    descriptors: dict[int, str]
    printed: dict[str, bytes] = field(default_factory=lambda: {"out": b"", "err": b"", "notes": b""})

    def wait(self, fault: Fault, timeout: float) -> int | None:
        """Read until the process ends, sending the fault's signal when it is due; its exit code, None for a hang.

        A fault's time counts from the child's message that it has begun.
        """
        started = time.perf_counter()
        due: float | None = None
        code: int | None = None
        with selectors.DefaultSelector() as selector, _process(self.pid) as handle:
            for descriptor in self.descriptors:
                os.set_blocking(descriptor, False)
                selector.register(descriptor, selectors.EVENT_READ)
            selector.register(handle, selectors.EVENT_READ)
            while code is None:
                passed = time.perf_counter() - started
                if due is None and self.printed["notes"] and fault.seconds is not None:
                    due = passed + fault.seconds
                if due is not None and passed >= due:
                    due = math.inf if self.strike(fault) else passed + RETRY_SECONDS
                if passed >= timeout:
                    return None
                for key, _ in selector.select(min(timeout, due or timeout) - passed):
                    if key.fd == handle:
                        code = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
                    elif not self._read(key.fd):
                        selector.unregister(key.fd)
        for descriptor in self.descriptors:
            while self._read(descriptor):
                pass
        return code

    def strike(self, fault: Fault) -> bool:
        """Send the fault's signal; False if there is no worker yet."""
        if fault.kind == "interrupt":
            os.killpg(self.pid, signal.SIGINT)
        elif fault.kind in SIGNALS:
            os.kill(self.pid, SIGNALS[fault.kind])
        else:
            members = group_members(self.pid)
            workers = sorted(pid for pid, parent in members.items() if parent in members and parent != self.pid)
            if not workers:
                return False
            with contextlib.suppress(ProcessLookupError):
                os.kill(workers[0], signal.SIGKILL)
        return True

    def end_group(self) -> int:
        """Wait until the processes that it started have ended too; kills those that don't, and returns how many."""
        until = time.perf_counter() + PATIENCE_SECONDS
        while (left := group_members(self.pid)) and time.perf_counter() < until:
            time.sleep(0.01)
        for pid in left:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        return len(left)

    def _read(self, descriptor: int) -> bool:
        try:
            found = os.read(descriptor, 2**16)
        except BlockingIOError:
            return False
        self.printed[self.descriptors[descriptor]] += found
        return bool(found)


@contextlib.contextmanager
def _process(pid: int) -> Any:
    handle = os.pidfd_open(pid)
    try:
        yield handle
    finally:
        os.close(handle)


def group_members(group: int) -> dict[int, int]:
    """Living processes of a process group, each with its parent."""
    found = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with contextlib.suppress(OSError):
                state, parent, its_group = (entry / "stat").read_text().rpartition(")")[2].split()[:3]
                if int(its_group) == group and state not in "ZX":
                    found[int(entry.name)] = int(parent)
    return found


def fork(request: dict[str, Any], fault: Fault) -> Child:
    """Start a command in a child."""
    pipes = {name: os.pipe() for name in ("out", "err", "notes")}
    pid = os.fork()
    if not pid:
        try:
            os.setsid()
            for name, target in (("out", 1), ("err", 2)):
                os.dup2(pipes[name][1], target)
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            notes = pipes["notes"][1]
            for name, (read, write) in pipes.items():
                os.close(read)
                if name != "notes":
                    os.close(write)
            work(request, fault, notes)
        finally:
            os._exit(70)
    for _, write in pipes.values():
        os.close(write)
    return Child(pid, {read: name for name, (read, _) in pipes.items()})


def work(request: dict[str, Any], fault: Fault, notes: int) -> None:
    """In the child: run the command as the installed script does, then end as Python does."""
    folder = Path(request["folder"])
    os.chdir(folder)
    os.environ.update(request["environment"])
    if request["checkpoint_seconds"] is not None:
        from motionkit.training.loop import train_loop

        assert train_loop.__kwdefaults__ is not None
        train_loop.__kwdefaults__["checkpoint_seconds"] = request["checkpoint_seconds"]
    operations = install(fault, folder)
    os.write(notes, b"\n")  # begun
    code = exit_code(request["arguments"])
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    if fault == UNDISTURBED:
        found = {"operations": operations, "modules": sorted(sys.modules)}
        with os.fdopen(notes, "w") as handle:
            json.dump(found, handle)
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    os._exit(code)


def exit_code(arguments: list[str]) -> int:
    """Run `motionkit ARGUMENTS`, or the function that `call:MODULE:NAME` names with the rest of them."""
    try:
        if arguments[0].startswith(CALL):
            module, _, name = arguments[0].removeprefix(CALL).partition(":")
            getattr(importlib.import_module(module), name)(*arguments[1:])
        else:
            from motionkit.cli.app import main

            sys.argv = ["motionkit", *arguments]
            main()
    except KeyboardInterrupt:
        return 130  # before `main` had begun
    except (MotionkitError, OSError) as error:  # as the app tells them, of a function that is called
        print(f"motionkit: {error}", file=sys.stderr)
        return 1
    except SystemExit as ended:
        return ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    except BaseException:
        traceback.print_exc()
        return 1
    return 0


def answer(request: dict[str, Any]) -> dict[str, Any]:
    """Run one command; returns its outcome."""
    fault = Fault(**request["fault"])
    started = time.perf_counter()
    child = fork(request, fault)
    code = child.wait(fault, request["timeout"])
    seconds = time.perf_counter() - started
    if code is None:
        os.kill(child.pid, signal.SIGKILL)
        os.waitpid(child.pid, 0)
    left = child.end_group()
    for descriptor in child.descriptors:
        os.close(descriptor)
    notes = json.loads(child.printed["notes"].strip() or b"{}")
    for name in notes.pop("modules", []):
        if name not in sys.modules and not name.startswith("__"):
            with contextlib.suppress(Exception):
                importlib.import_module(name)
    require_few_threads()
    texts = {name: child.printed[name].decode(errors="replace") for name in ("out", "err")}
    return {"code": code, "seconds": seconds, "left": left, "operations": notes.get("operations", []), **texts}


def main() -> None:
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # nothing that a library prints may come between the answers
    import_everything()
    require_few_threads()
    for line in sys.stdin:
        print(json.dumps(answer(json.loads(line))), file=answers, flush=True)


if __name__ == "__main__":
    main()
