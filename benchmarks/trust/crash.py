"""Commands killed before every file operation, at bytes of files and at random moments: is anything lost?

After each fault the store must be in its old or its new state and `validate` agree, files that have their names must be
whole, and the command, repeated, must end with the very files of an undisturbed run and no other ones.
"""

import math
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from benchmarks.trust.disk import NoDiskError, SmallDisk
from benchmarks.trust.faults import Fault
from benchmarks.trust.missing import MISSING
from benchmarks.trust.process import Commands
from benchmarks.trust.report import Case, Report
from benchmarks.trust.scenarios import SCENARIOS, Scenario
from benchmarks.trust.trials import DISK_FAULTS, Attempt, Drill, Expected, UndisturbedError
from eval.report.results import environment
from motionkit.cli.console import progress
from motionkit.core.progress import Progress

DEFAULT_SECONDS = 300.0
# Number of trials of each kind in a whole drill; of file operations it tries all.
NUM_TRIALS = {
    "bytes": 12,
    "moment": 12,
    "limit": 6,
    "full": 6,
    "read-only": 1,
    "interrupt": 6,
    "terminate": 3,
    "worker": 6,
}
KINDS = {
    "operation": "before file operations",
    "bytes": "at bytes",
    "moment": "at moments",
    "worker": "workers",
    "limit": "file too large",
    "full": "disk full",
    "read-only": "read-only",
    "interrupt": "Ctrl-C",
    "terminate": "SIGTERM",
}


def run(
    seed: int, seconds: float, folder: Path, names: Sequence[str] = tuple(SCENARIOS), most: int | None = None
) -> Report:
    """Try faults in each scenario in turn until all are tried or the time is up; the quickest scenarios go first.

    `names` chooses scenarios, `most` is how many faults each is tried with at most.
    """
    started = time.perf_counter()
    with ExitStack() as held:
        commands, on_progress = held.enter_context(Commands()), held.enter_context(progress())
        total = None if math.isinf(seconds) else int(seconds)
        try:
            disk, no_disk = held.enter_context(SmallDisk(folder / "disk")), ()
        except NoDiskError as error:
            disk, no_disk = None, (Case("disk full, read-only", 0, skipped=str(error)),)
        drill = Drill(commands, folder, disk)
        trials = [_Trials(name, attempts(drill, SCENARIOS[name], seed, most)) for name in names]
        if most is None:
            trials += [_Trials(name, made(drill)) for name, made in MISSING.items()]
        while (waiting := [each for each in trials if not each.finished]) and (
            (passed := time.perf_counter() - started) < seconds
        ):
            following = min(waiting, key=lambda each: each.seconds)
            on_progress(Progress("crash", int(passed), total, following.name))
            following.go_on()
    cases = (*(each.case() for each in trials), *no_disk)
    return Report("crash", seed, time.perf_counter() - started, cases, environment())


class _Trials:
    """Trials of one kind, one after the other; owns their results."""

    def __init__(self, name: str, attempts: Iterator[Attempt]) -> None:
        self.name = name
        self.seconds = 0.0
        self.finished = False
        self._attempts = attempts
        self._counts: Counter[str] = Counter()
        self._failures: list[str] = []

    def go_on(self) -> None:
        """Make the next attempt; the first one prepares the others."""
        started = time.perf_counter()
        try:
            attempt = next(self._attempts, None)
        except UndisturbedError as error:
            attempt = None
            self._failures.append(str(error))
        if attempt is None:
            self.finished = True
        else:
            self._counts[attempt.kind] += 1
            self._failures += [f"{attempt.about}: {attempt.problem}"] if attempt.problem else []
        self.seconds += time.perf_counter() - started

    def case(self) -> Case:
        """What came of it."""
        return Case(self.name, self._counts.total(), tuple(self._failures), dict(sorted(self._counts.items())))


def attempts(drill: Drill, scenario: Scenario, seed: int, most: int | None) -> Iterator[Attempt]:
    """Try a scenario with its faults, or with the first few of them."""
    expected = drill.prepare(scenario)
    for fault, about in faults(scenario, expected, seed, has_disk=drill.disk is not None)[:most]:
        yield Attempt(KINDS[fault.kind], f"{fault}{about}", drill.attempt(scenario, fault))


def faults(scenario: Scenario, expected: Expected, seed: int, *, has_disk: bool) -> list[tuple[Fault, str]]:
    """All faults of a scenario, in a random order, each with its details."""
    generator = np.random.default_rng([seed, *scenario.name.encode()])
    found: list[tuple[Fault, str]] = []
    for kind in scenario.modes:
        if kind in DISK_FAULTS and not has_disk:
            continue
        if kind == "operation":
            found += [(Fault(kind, number), f" ({name})") for number, name in enumerate(expected.operations)]
            continue
        for _ in range(NUM_TRIALS[kind]):
            if kind in ("bytes", "limit"):
                size = int(generator.choice(expected.sizes))
                found.append((Fault(kind, int(size * generator.random())), ""))
            elif kind == "full":
                found.append((Fault(kind, int(1.2 * sum(expected.sizes) * generator.random())), ""))
            else:
                found.append((Fault(kind, float(expected.seconds * generator.random())), ""))
    return [found[index] for index in generator.permutation(len(found))]
