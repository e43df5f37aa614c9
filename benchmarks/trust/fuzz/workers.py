"""Inputs tried in forked processes with limits on additional memory and on processor time.

A process tries a block of inputs; if it dies (time limit, a crash in a library) the parent records the input and
continues after it with another process.
"""

import faulthandler
import mmap
import os
import resource
import signal
import struct
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

import torch

from benchmarks.trust.fuzz.archives import prepare_bombs
from benchmarks.trust.fuzz.mutate import generator, mutate
from benchmarks.trust.fuzz.target import Target
from motionkit.core.errors import MotionkitError

MOST_BYTES = 1 << 30
MOST_SECONDS = 2.0
# A waiting process uses no processor time; after this long at one input it counts as hanging.
STUCK_SECONDS = 60.0
SHOWN_CHARACTERS = 300
# Number of retries of an input that exceeds its time before it counts as failed.
RETRIES = 2
PAGE_BYTES = resource.getpagesize()
# A child's progress in shared memory: next input, refused, read, seconds of the slowest, its number.
PROGRESS = struct.Struct("<qqqdq")


@dataclass
class Tally:
    """Results of the inputs of one reader: `read` without error, `refused` by own errors, or failed.

    `next_number` is that of its next input, already tried `retries` times, `seconds` the time that its processes took.
    """

    next_number: int = 0
    retries: int = 0
    refused: int = 0
    read: int = 0
    seconds: float = 0.0
    slowest_seconds: float = 0.0
    slowest_number: int = -1
    failures: list[str] = field(default_factory=list)

    @property
    def tried(self) -> int:
        """Number of inputs."""
        return self.refused + self.read + len(self.failures)


@dataclass(frozen=True)
class Block:
    """A child process that tries inputs of one target."""

    target: Target
    seed: int
    child: int
    begun: float
    progress: mmap.mmap
    report: IO[bytes]
    last: list[tuple[int, float]] = field(default_factory=list)

    def is_stuck(self) -> bool:
        """Whether the child has spent a minute of wall time on one input."""
        number, now = PROGRESS.unpack(self.progress[:])[0], time.monotonic()
        if not self.last or self.last[0][0] != number:
            self.last[:] = [(number, now)]
        return now - self.last[0][1] > STUCK_SECONDS

    @classmethod
    def start(cls, target: Target, seed: int, numbers: range, seconds: float, folder: Path) -> "Block":
        """Fork a child that tries these inputs until the seconds are over; `folder` holds the prepared sources.

        The forking process must not have threads that hold locks.
        """
        progress, report, begun = mmap.mmap(-1, PROGRESS.size), tempfile.TemporaryFile(), time.monotonic()  # noqa: SIM115
        progress[:] = PROGRESS.pack(numbers.start, 0, 0, 0.0, -1)
        child = os.fork()
        if child == 0:
            _work(target, seed, numbers, begun + seconds, folder, progress, report.fileno())
        return cls(target, seed, child, begun, progress, report)

    def add_to(self, tally: Tally, status: int) -> None:
        """Add the results of the inputs, after the child has ended with a status of `os.wait`."""
        number, refused, read, slowest, slowest_number = PROGRESS.unpack(self.progress[:])
        tally.refused, tally.read = tally.refused + refused, tally.read + read
        if slowest > tally.slowest_seconds:
            tally.slowest_seconds, tally.slowest_number = slowest, slowest_number
        with self.report as report:
            report.seek(0)
            tally.failures += report.read().decode().splitlines()
        tally.seconds += time.monotonic() - self.begun
        if number != tally.next_number:
            tally.retries = 0
        tally.next_number = number
        if status:
            ended = signal.Signals(os.WTERMSIG(status)).name if os.WIFSIGNALED(status) else f"exit {status >> 8}"
            # A shared machine may count its own pauses as processor time.
            if ended == "SIGPROF" and tally.retries < RETRIES:
                tally.retries += 1
                return
            reason = f"more than {MOST_SECONDS:g} s of processor time" if ended == "SIGPROF" else f"ended by {ended}"
            tally.failures.append(f"{self.target.name}:{self.seed}:{number}: {reason}")
            tally.next_number, tally.retries = number + 1, 0


def _work(
    target: Target, seed: int, numbers: range, until: float, folder: Path, progress: mmap.mmap, report: int
) -> None:
    """The child: it never returns."""
    code = 1
    try:
        # The child's own limit ends it; its output is discarded.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.dup2(1, 2)
        faulthandler.disable()
        signal.signal(signal.SIGPROF, signal.SIG_DFL)
        warnings.simplefilter("error")
        refused = read = 0
        slowest, slowest_number = 0.0, -1
        for number in numbers:
            progress[:] = PROGRESS.pack(number, refused, read, slowest, slowest_number)
            outcome = try_input(target, seed, number, folder)
            if outcome.seconds > slowest:
                slowest, slowest_number = outcome.seconds, number
            if outcome.fault is None:
                read += 1
            elif outcome.fault:
                os.write(report, f"{target.name}:{seed}:{number}: {outcome.fault}\n".encode("utf-8", "replace"))
            else:
                refused += 1
            progress[:] = PROGRESS.pack(number + 1, refused, read, slowest, slowest_number)
            if time.monotonic() > until:
                break
        code = 0
    except BaseException as error:
        os.write(report, f"{target.name}:{seed}: the drill itself: {_described(error)}\n".encode("utf-8", "replace"))
    finally:
        os._exit(code)


@dataclass(frozen=True)
class Outcome:
    """Result of one input: `fault` is None if it was read, "" if it was refused; and its processor time."""

    fault: str | None
    seconds: float


def try_input(target: Target, seed: int, number: int, folder: Path) -> Outcome:
    """Damage a source by (reader, seed, number), read it within the limits, and restore the source."""
    with damaged_source(target, seed, number, folder) as place:
        begun = time.process_time()
        try:
            _use_limited(target, place)
            fault = None
        except MotionkitError as error:
            fault = "" if str(error).strip() else f"{type(error).__name__} without a message"
        except BaseException as error:
            fault = _described(error)
        seconds = time.process_time() - begun
    return Outcome(fault, seconds)


@contextmanager
def damaged_source(target: Target, seed: int, number: int, folder: Path) -> Iterator[Path]:
    """The source of one input, damaged while the block runs, under a unique name."""
    rng = generator(target.name, seed, number)
    source = rng.choice(sorted(path for path in folder.iterdir() if path.is_dir()))
    victim = rng.choice(target.victims(source))
    # Readers may cache by path.
    place = source.with_name(f"{source.name}.{number}")
    original = victim.read_bytes()
    damaged = mutate(rng, victim.name, original)
    victim.write_bytes(target.sealed(victim, damaged) if target.sealed else damaged)
    source.rename(place)
    try:
        yield place
    finally:
        place.rename(source)
        victim.write_bytes(original)
        if target.after is not None:
            target.after(source)


def _use_limited(target: Target, place: Path) -> None:
    """Read with limits on memory and processor time; exceeding the time ends the process."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * PAGE_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (used + MOST_BYTES, before[1]))
    signal.setitimer(signal.ITIMER_PROF, MOST_SECONDS)
    try:
        target.use(place)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        resource.setrlimit(resource.RLIMIT_AS, before)


def _described(error: BaseException) -> str:
    frames = [
        frame for frame in traceback.extract_tb(error.__traceback__) if "/benchmarks/trust/" not in frame.filename
    ]
    where = " < ".join(f"{'/'.join(Path(each.filename).parts[-2:])}:{each.lineno}" for each in reversed(frames[-4:]))
    text = " ".join(f"{type(error).__name__}: {error}".split())[:SHOWN_CHARACTERS]
    return f"{text} at {where}" if where else text


def prepare(targets: Sequence[Target], folder: Path) -> None:
    """Write the sources of all targets, each into a folder of its own, and read each undamaged.

    Libraries that reserve memory once do so here. Raises the reader's error if a source is not valid.
    """
    # Threads do not survive a fork; waiting for them would hang.
    torch.set_num_threads(1)
    prepare_bombs()
    for target in targets:
        for index, make in enumerate(target.makes):
            place = folder / target.name / f"source-{index}"
            place.mkdir(parents=True)
            make(place)
            target.use(place)
            if target.after is not None:
                target.after(place)
