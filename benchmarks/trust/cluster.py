"""Kills of one of several processes: Ray's workers during ingest, the ranks of a training."""

import importlib.util
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from benchmarks.trust.process import Commands, one_thread
from benchmarks.trust.report import Case
from benchmarks.trust.scenarios import STORE, takes, train
from benchmarks.trust.trees import copy, difference, tree
from benchmarks.trust.trials import Drill

NUM_TRIALS = 2
NUM_TAKES, TAKE_SECONDS = 48, "8.0"
NUM_STEPS = 200
# Figures of ranks are added up whenever a checkpoint is due: their sums are the same up to the order of adding.
DIGITS = 12
PATIENCE_SECONDS = 300.0
RAY_TASK = b"ray::_compute"


def cases(seed: int, folder: Path) -> Iterator[Case]:
    """Kill a worker of Ray, and a rank, a few times each."""
    generator = np.random.default_rng(seed)
    with Commands() as commands:
        drill = Drill(commands, folder, disk=None)
        if importlib.util.find_spec("ray") is None:
            yield Case("ingest by Ray, a worker killed", 0, skipped="Ray is not installed")
        else:
            yield ray_case(drill, generator)
        yield ranks_case(drill, generator)


def ray_case(drill: Drill, generator: np.random.Generator) -> Case:
    """Ingest by Ray, kill one of its workers while it works, and compare with the store of one process."""
    place, failures = drill.folder / "ray", []
    place.mkdir(parents=True)
    for arguments in (takes("takes", 0, NUM_TAKES, TAKE_SECONDS), ("ingest", "takes", *STORE, "--workers", "1")):
        if drill.commands.run(place, arguments).code:
            return Case("ingest by Ray, a worker killed", 0, (f"{arguments[0]} failed",))
    expected = tree(place / "store")
    killed = 0
    for number in range(NUM_TRIALS):
        name = f"store-{number}"
        command = [
            sys.executable,
            "-m",
            "motionkit",
            "ingest",
            "takes",
            "--store",
            name,
            "--engine",
            "ray",
            "--workers",
            "2",
        ]
        with running(command, place) as process:
            seconds = float(generator.uniform(0.0, 1.0))
            killed += kill_one(process, lambda pid: RAY_TASK in command_line(pid), seconds)
            code, message = end_of(process)
        if code != 0:
            failures.append(f"a worker killed after {seconds:.3f} s: exit code {code}: {message}")
        elif differing := difference(tree(place / name), expected):
            failures.append(f"a worker killed after {seconds:.3f} s: another store: {differing}")
    return Case("ingest by Ray, a worker killed", NUM_TRIALS, tuple(failures), {"killed": killed})


def ranks_case(drill: Drill, generator: np.random.Generator) -> Case:
    """Train with two ranks, kill one of them, resume, and compare with what two undisturbed ones train."""
    start, failures = drill.start_of("codebook"), []
    whole, place = drill.folder / "ranks-whole", drill.folder / "ranks"
    copy(start, whole)
    with running(ranks_command(), whole) as process:
        code, message = end_of(process)
    if code != 0:
        return Case("one of two ranks killed", 0, (f"undisturbed: exit code {code}: {message}",))
    saved = place / "runs" / "drill" / "field" / "checkpoint.safetensors"
    killed = 0
    for _ in range(NUM_TRIALS):
        copy(start, place)
        rank, seconds = int(generator.integers(2)), float(generator.uniform(0.0, 2.0))

        def is_wanted(pid: int, rank: int = rank) -> bool:
            return saved.exists() and rank_of(pid) == rank

        with running(ranks_command(), place) as process:
            killed += kill_one(process, is_wanted, seconds)
            end_of(process)
        with running(ranks_command("--resume"), place) as process:
            code, message = end_of(process)
        if code != 0:
            failures.append(
                f"rank {rank} killed {seconds:.3f} s after the first save: resumed, exit code {code}: {message}"
            )
        elif differing := difference(tree(place, DIGITS), tree(whole, DIGITS)):
            failures.append(f"rank {rank} killed {seconds:.3f} s after the first save: resumed, {differing}")
    return Case("one of two ranks killed", NUM_TRIALS, tuple(failures), {"killed": killed})


def ranks_command(*options: str) -> list[str]:
    """Train the field with two ranks, saving often."""
    torchrun = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", "-m", "--"]
    steps = ("--set", f"field.schedule.steps={NUM_STEPS}")
    return [*torchrun, "benchmarks.trust.often", *train("field"), *steps, *options]


@contextmanager
def running(command: list[str], folder: Path) -> "Iterator[subprocess.Popen[str]]":
    """A process that is ended, with all that it has started, when the block ends."""
    process = subprocess.Popen(
        command, cwd=folder, env=one_thread(), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    try:
        yield process
    finally:
        for pid in (*descendants(process.pid), process.pid):
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        process.communicate()


def end_of(process: "subprocess.Popen[str]") -> tuple[int | None, str]:
    """A process's exit code, None for a hang, and the last line of its output."""
    try:
        message = process.communicate(timeout=PATIENCE_SECONDS)[1].strip().splitlines()
    except subprocess.TimeoutExpired:
        return None, "it hangs"
    return process.returncode, (message or [""])[-1]


def kill_one(process: "subprocess.Popen[str]", wanted: Callable[[int], bool], seconds: float) -> bool:
    """Wait for a matching descendant, and a while longer, then kill one; False if there was none in time."""
    until: float | None = None
    while process.poll() is None:
        found = [pid for pid in descendants(process.pid) if wanted(pid)]
        if found and until is None:
            until = time.perf_counter() + seconds
        if found and until is not None and time.perf_counter() >= until:
            with suppress(ProcessLookupError):
                os.kill(found[0], signal.SIGKILL)
                return True
        time.sleep(0.02)
    return False


def descendants(pid: int) -> list[int]:
    """All descendants of a process."""
    children: dict[int, list[int]] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with suppress(OSError):
                parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
                children.setdefault(parent, []).append(int(entry.name))
    found, waiting = [], [pid]
    while waiting:
        of_one = children.get(waiting.pop(), [])
        found += of_one
        waiting += of_one
    return found


def command_line(pid: int) -> bytes:
    """A process's command line; empty if it has ended."""
    with suppress(OSError):
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    return b""


def rank_of(pid: int) -> int | None:
    """A process's rank under torchrun; None if it has none."""
    with suppress(OSError):
        for variable in Path(f"/proc/{pid}/environ").read_bytes().split(b"\0"):
            if variable.startswith(b"RANK="):
                return int(variable[5:])
    return None
