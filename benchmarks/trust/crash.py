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
from benchmarks.trust.process import Commands
from benchmarks.trust.report import Case, Report
from benchmarks.trust.scenarios import SCENARIOS, Scenario
from benchmarks.trust.trials import DISK_FAULTS, Drill, Expected, UndisturbedError
from eval.report.results import environment
from motionkit.console import progress

DEFAULT_SECONDS = 300.0
# How many of each kind a whole drill tries; of file operations it tries all.
NUM_TRIALS = {"bytes": 12, "moment": 12, "limit": 6, "full": 6, "read-only": 1, "interrupt": 6, "worker": 6}
KINDS = {
    "operation": "before file operations",
    "bytes": "at bytes",
    "moment": "at moments",
    "worker": "workers",
    "limit": "file too large",
    "full": "disk full",
    "read-only": "read-only",
    "interrupt": "Ctrl-C",
}


def run(
    seed: int, seconds: float, folder: Path, names: Sequence[str] = tuple(SCENARIOS), most: int | None = None
) -> Report:
    """Try faults in each scenario in turn until all are tried or the time is up; those that took least go first.

    `names` chooses scenarios, `most` is how many faults each is tried with at most.
    """
    started = time.perf_counter()
    with ExitStack() as held:
        commands, display = held.enter_context(Commands()), held.enter_context(progress())
        task = display.add_task("crash", total=None if math.isinf(seconds) else seconds, note="")
        try:
            disk, no_disk = held.enter_context(SmallDisk(folder / "disk")), ()
        except NoDiskError as error:
            disk, no_disk = None, (Case("disk full, read-only", 0, skipped=str(error)),)
        drill = Drill(commands, folder, disk)
        trials = [_Trials(SCENARIOS[name], drill, seed, most) for name in names]
        while (waiting := [each for each in trials if not each.finished]) and (
            (passed := time.perf_counter() - started) < seconds
        ):
            following = min(waiting, key=lambda each: each.seconds)
            display.update(task, completed=passed, note=following.scenario.name)
            following.go_on()
    cases = (*(each.case() for each in trials), *no_disk)
    return Report("crash", seed, time.perf_counter() - started, cases, environment())


class _Trials:
    """The trials of one scenario in a random order; owns what came of them."""

    def __init__(self, scenario: Scenario, drill: Drill, seed: int, most: int | None) -> None:
        self.scenario = scenario
        self.seconds = 0.0
        self.finished = False
        self._drill = drill
        self._seed, self._most = seed, most
        self._left: Iterator[tuple[Fault, str]] = iter(())
        self._prepared = False
        self._tried: list[Fault] = []
        self._failures: list[str] = []

    def go_on(self) -> None:
        """Prepare, or try the next fault."""
        started = time.perf_counter()
        if not self._prepared:
            self._prepared = True
            try:
                expected, has_disk = self._drill.prepare(self.scenario), self._drill.disk is not None
                found = faults(self.scenario, expected, self._seed, has_disk=has_disk)
                self._left = iter(found[: self._most])
            except UndisturbedError as error:
                self._failures.append(str(error))
        elif (following := next(self._left, None)) is None:
            self.finished = True
        else:
            fault, about = following
            self._tried.append(fault)
            if problem := self._drill.attempt(self.scenario, fault):
                self._failures.append(f"{fault}{about}: {problem}")
        self.seconds += time.perf_counter() - started

    def case(self) -> Case:
        """What came of it."""
        kinds = Counter(fault.kind for fault in self._tried)
        figures = {f"{KINDS[kind]}": kinds[kind] for kind in self.scenario.modes}
        return Case(self.scenario.name, len(self._tried), tuple(self._failures), figures)


def faults(scenario: Scenario, expected: Expected, seed: int, *, has_disk: bool) -> list[tuple[Fault, str]]:
    """Every fault that a scenario is tried with, in a random order, each with what is known of it."""
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
