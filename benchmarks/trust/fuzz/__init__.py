"""Damaged files for every reader: each returns a motion or raises an own error, within 2 s of CPU time and 1 GiB.

Every reader gets the same share of the time, by as many processes as there are processors. A failure is reported as
READER:SEED:NUMBER; that input is made again by

    python -m benchmarks.trust.fuzz READER:SEED:NUMBER [--keep FOLDER]
"""

import os
import signal
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.trust.fuzz.target import Target
from benchmarks.trust.fuzz.targets import all_targets
from benchmarks.trust.fuzz.workers import Block, Tally, prepare
from benchmarks.trust.report import Case, Report
from eval.report.results import environment
from motionkit.store.workers import usable_cores

DEFAULT_SECONDS = 1200.0
BLOCK_SECONDS = 5.0
MANY = 1 << 40


def run(seed: int, seconds: float, folder: Path) -> Report:
    """Try inputs for about this long."""
    begun = time.monotonic()
    targets = all_targets()
    prepare(targets, folder)
    tallies = fuzz(targets, seed, folder, until=begun + seconds)
    return report(targets, tallies, seed, time.monotonic() - begun)


def run_inputs(targets: Sequence[Target], seed: int, inputs_each: int, folder: Path) -> Report:
    """Try the same number of inputs of each of these readers, however long it takes."""
    begun = time.monotonic()
    prepare(targets, folder)
    tallies = fuzz(targets, seed, folder, inputs_each=inputs_each)
    return report(targets, tallies, seed, time.monotonic() - begun)


def report(targets: Sequence[Target], tallies: Sequence[Tally], seed: int, seconds: float) -> Report:
    """The counts of all readers."""
    cases = [
        Case(
            target.name,
            tally.tried,
            tuple(tally.failures),
            {
                "refused": tally.refused,
                "read": tally.read,
                "inputs_per_second": round(tally.tried / max(tally.seconds, 1e-9), 1),
                "slowest_seconds": round(tally.slowest_seconds, 3),
                "slowest_number": tally.slowest_number,
            },
        )
        for target, tally in zip(targets, tallies, strict=True)
    ]
    return Report("fuzz", seed, seconds, tuple(cases), environment())


def fuzz(
    targets: Sequence[Target],
    seed: int,
    folder: Path,
    *,
    until: float = float("inf"),
    inputs_each: int = MANY,
) -> list[Tally]:
    """Try inputs of all targets, prepared in `folder`, the one with the least time first; one tally for each."""
    tallies = [Tally() for _ in targets]
    running: dict[int, tuple[int, Block]] = {}
    while True:
        busy = {index for index, _ in running.values()}
        waiting = [
            index for index in range(len(targets)) if index not in busy and tallies[index].next_number < inputs_each
        ]
        left = until - time.monotonic()
        if waiting and left > 0 and len(running) < usable_cores():
            index = min(waiting, key=lambda each: tallies[each].seconds)
            numbers = range(tallies[index].next_number, inputs_each)
            target = targets[index]
            block = Block.start(target, seed, numbers, min(BLOCK_SECONDS, left), folder / target.name)
            running[block.child] = (index, block)
        elif running:
            for child in list(running):
                ended, status = os.waitpid(child, os.WNOHANG)
                if ended:
                    index, block = running.pop(child)
                    block.add_to(tallies[index], status)
                elif running[child][1].is_stuck():
                    os.kill(child, signal.SIGKILL)
            time.sleep(0.02)
        else:
            return tallies
