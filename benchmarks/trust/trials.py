"""One trial: inject a fault into a command, check its files, repeat the command and compare the result."""

import json
import re
import signal
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from benchmarks.trust.disk import SmallDisk
from benchmarks.trust.faults import UNDISTURBED, Fault
from benchmarks.trust.process import Commands, Outcome
from benchmarks.trust.scenarios import CALL, STARTS, Scenario
from benchmarks.trust.trees import copy, difference, tree

ABSENT = "absent"
# Names of temporary files.
TEMPORARY = re.compile(r"(^|/)\.|\.partial/")
# Permitted exit codes; 130 is Ctrl-C's.
CODES: dict[str, tuple[int, ...]] = {
    "operation": (0, -signal.SIGKILL),
    "moment": (0, -signal.SIGKILL),
    "bytes": (0, -signal.SIGXFSZ),
    "worker": (0,),
    "limit": (0, 1),
    "full": (0, 1),
    "read-only": (1,),
    "interrupt": (0, 130),
    "terminate": (0, 130),
}
DISK_FAULTS = ("full", "read-only")


class UndisturbedError(Exception):
    """A command that fails, or has another result, without any fault, which prevents the trials."""


@dataclass(frozen=True)
class Expected:
    """The reference of an undisturbed run: the folder before it, after it, and after it was repeated.

    `before` and `after` of the store are what a reader finds in it (`corpus.look`).
    """

    start: Path
    before: dict[str, str]
    after: dict[str, str]
    repeated: dict[str, str]
    store_before: dict[str, Any]
    store_after: dict[str, Any]
    operations: tuple[str, ...]
    seconds: float
    sizes: tuple[int, ...]


@dataclass(frozen=True)
class Attempt:
    """One trial: its kind, the fault, and the failure, if any."""

    kind: str
    about: str
    problem: str


class Drill:
    """Makes starting folders once and tries faults in copies of them; owns the folder that it is given."""

    def __init__(self, commands: Commands, folder: Path, disk: SmallDisk | None) -> None:
        self.commands = commands
        self.folder = folder
        self.disk = disk
        self.expected: dict[str, Expected] = {}

    def start_of(self, name: str) -> Path:
        """The starting folder of this name, created if it is missing."""
        path = self.folder / "starts" / name.replace(" ", "-")
        if path.exists():
            return path
        base, commands = STARTS[name]
        making = path.with_name(f"{path.name}.making")
        if base:
            copy(self.start_of(base), making)
        else:
            making.mkdir(parents=True)
        for arguments in commands:
            require_success(self.commands.run(making, arguments), arguments)
        making.rename(path)
        return path

    def prepare(self, scenario: Scenario) -> Expected:
        """Run the command undisturbed, three times: twice from the start, which must agree, and once more."""
        if scenario.name in self.expected:
            return self.expected[scenario.name]
        start, place = self.start_of(scenario.start), self.folder / "place"
        ends = []
        for _ in range(2):
            copy(start, place)
            before = tree(place)
            store_before = self.look(scenario, place)
            outcome = self.run(scenario, place)
            require_success(outcome, scenario.command)
            ends.append(tree(place))
        if differing := difference(ends[1], ends[0]):
            raise UndisturbedError(f"{scenario.name} does not give the same twice, without any fault: {differing}")
        store_after = self.look(scenario, place)
        changed = [place / name for name in ends[0] if ends[0][name] != before.get(name)]
        sizes = tuple(path.stat().st_size for path in changed if path.is_file() and path.stat().st_size)
        again = self.run(scenario, place, repeating=True)
        if not refuses(again, scenario):
            require_success(again, scenario.repetition)
        self.expected[scenario.name] = Expected(
            start=start,
            before=before,
            after=ends[0],
            repeated=tree(place),
            store_before=store_before,
            store_after=store_after,
            operations=outcome.operations,
            seconds=outcome.seconds,
            sizes=sizes,
        )
        return self.expected[scenario.name]

    def attempt(self, scenario: Scenario, fault: Fault) -> str:
        """Try one fault; returns the failure in a line, or nothing."""
        expected = self.prepare(scenario)
        disk = self.disk if fault.kind in DISK_FAULTS else None
        place = (self.folder if disk is None else disk.path) / "place"
        copy(expected.start, place)
        with nullcontext() if disk is None else disk.suffering(fault):
            hit = self.run(scenario, place, fault)
            found = self.look(scenario, place)
            problem = ending_fault(hit, expected, endings(scenario, fault)) or state_fault(
                scenario, expected, place, found
            )
        return problem or self.repetition_fault(scenario, expected, place, found)

    def run(self, scenario: Scenario, place: Path, fault: Fault = UNDISTURBED, *, repeating: bool = False) -> Outcome:
        """Run the scenario's command, or its repetition."""
        every = 0.0 if scenario.saves_every_step else None
        arguments = scenario.repetition if repeating else scenario.command
        return self.commands.run(place, arguments, fault, checkpoint_seconds=every)

    def look(self, scenario: Scenario, place: Path) -> dict[str, Any]:
        """What a reader finds in the scenario's store."""
        if not scenario.store:
            return {}
        outcome = self.commands.run(place, (f"{CALL}look", scenario.store))
        if outcome.code:
            return {"unreadable": outcome.last_line}
        found: dict[str, Any] = json.loads(outcome.out)
        return found

    def repetition_fault(self, scenario: Scenario, expected: Expected, place: Path, found: dict[str, Any]) -> str:
        """Repeat the command; the result must equal that of an undisturbed run or of its repetition."""
        stored = found == expected.store_after != expected.store_before
        done = stored or all(tree(place).get(name) == digest for name, digest in expected.after.items())
        again = self.run(scenario, place, repeating=True)
        if again.code != 0 and not (done and refuses(again, scenario)):
            return f"repeated, it ends with exit code {again.code}: {again.last_line}"
        end = tree(place)
        if end in (expected.after, expected.repeated):
            return ""
        return f"repeated, it ends with another result: {difference(end, expected.after)}"


def state_fault(scenario: Scenario, expected: Expected, place: Path, found: dict[str, Any]) -> str:
    """What is in neither its old nor its new state: the store as a reader sees it, or a file that must be whole."""
    if found not in (expected.store_before, expected.store_after):
        return f"the store {scenario.store} is neither in its old nor in its new state: {json.dumps(found)}"
    there = tree(place)
    for name in sorted({path.relative_to(place).as_posix() for each in scenario.whole for path in place.glob(each)}):
        known = (expected.before.get(name, ABSENT), expected.after.get(name, ABSENT))
        if not TEMPORARY.search(name) and there[name] not in known:
            return f"{name} is half written"
    return ""


def refuses(outcome: Outcome, scenario: Scenario) -> bool:
    """Whether a repeated command says that there is nothing left to do."""
    return bool(scenario.refusal) and outcome.code in (1, 2) and bool(re.search(scenario.refusal, outcome.err))


def endings(scenario: Scenario, fault: Fault) -> tuple[int, ...]:
    """Exit codes that a fault may end a command with; SIGTERM kills a program that merely calls a function."""
    called = fault.kind == "terminate" and scenario.command[0].startswith(CALL)
    return (*CODES[fault.kind], -signal.SIGTERM) if called else CODES[fault.kind]


def ending_fault(hit: Outcome, expected: Expected, codes: tuple[int, ...]) -> str:
    """The fault in how a disturbed command ended."""
    if hit.code is None:
        return f"it hung: after {hit.seconds:.0f} s it was still running"
    if hit.left:
        return f"{hit.left} of its processes were still there ten seconds later"
    if shows_traceback(hit):
        return f"a traceback: {hit.last_line}"
    if hit.code not in codes:
        return f"it ended with exit code {hit.code}: {hit.last_line}"
    if hit.code == 1 and not (hit.last_line.startswith("motionkit: ") and names_a_file(hit.last_line, expected)):
        return f"it failed without saying what with: {hit.last_line}"
    return ""


def shows_traceback(outcome: Outcome) -> bool:
    """Whether a command printed a traceback."""
    return "Traceback" in outcome.err or "Exception ignored" in outcome.err


def names_a_file(line: str, expected: Expected) -> bool:
    """Whether a message names one of the files that were to be written, or a folder that they are in."""
    written = {name for name, digest in expected.after.items() if expected.before.get(name) != digest}
    folders = {parent.as_posix() for name in written for parent in PurePosixPath(name).parents} - {"."}
    return any(name in line for name in written | folders)


def require_success(outcome: Outcome, arguments: tuple[str, ...]) -> None:
    """Raise `UndisturbedError` if an undisturbed command failed."""
    if outcome.code != 0:
        raise UndisturbedError(
            f"undisturbed, {' '.join(arguments)} ended with exit code {outcome.code}: {outcome.last_line}"
        )
