"""Commands killed before every file operation, at bytes of files and at random moments: is anything lost?

After each fault the store must be in its old or its new state and `validate` agree, files that have their names must be
whole, and the command, repeated, must end with the files of an undisturbed run and no other ones. A file that vanishes
under a reader or before a command is named.
"""

import hashlib
import json
import re
import shutil
import signal
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from benchmarks.trust.process import UNDISTURBED, Fault, Outcome, run_command
from benchmarks.trust.scenarios import CALL, RUN, SCENARIOS, STARTS, STORE, Arguments, Scenario, train
from eval.report.results import environment
from motionkit.core.errors import MotionkitError
from motionkit.core.files import MANIFEST_FILE
from motionkit.store import Store
from motionkit.store.validate import faults

# Number of trials of each kind in a whole drill; of file operations it tries all.
NUM_TRIALS = {"bytes": 12, "moment": 12, "limit": 6, "interrupt": 6, "terminate": 3}
# Permitted exit codes; 130 is Ctrl-C's.
CODES: dict[str, tuple[int, ...]] = {
    **dict.fromkeys(("operation", "moment"), (0, -signal.SIGKILL)),
    "bytes": (0, -signal.SIGXFSZ),
    "limit": (0, 1),
    **dict.fromkeys(("interrupt", "terminate"), (0, 130)),
}
TEMPORARY = re.compile(r"(^|/)\.|\.partial/")
LEFT = re.compile(r"(results|made|completed)/\.[^/]+\.tmp(\.\w+)?")
"""What a killed command may leave in folders that it does not lock (docs/reliability.md)."""
# Commands that meet a missing file.
MEETING: tuple[Arguments, ...] = (
    ("validate", *STORE),
    ("export", "out", "--format", "npz", *STORE),
    (*train("field"), "--resume"),
    ("generate", "--action", "walk", "--fps", "30", "--seconds", "1", "--out", "made", *RUN),
)
# Times, and checksums of files that hold them: of the document itself, of metrics.jsonl.
VOLATILE = frozenset(("checksum", "cpu_seconds", "metrics", "metrics.jsonl", "time", "wall_seconds"))
TIMED = (".jsonl", "summary.json")
SHOWN = 3


@dataclass(frozen=True)
class Case:
    """One kind of trial: the number of trials, and each failure in one line that says how to repeat it.

    `figures` holds further numbers.
    """

    name: str
    tried: int
    failures: tuple[str, ...]
    figures: Mapping[str, float]


@dataclass(frozen=True)
class Report:
    """One part of the drill, after it ran."""

    part: str
    seed: int
    seconds: float
    cases: tuple[Case, ...]
    environment: Mapping[str, Any]

    @property
    def failures(self) -> tuple[str, ...]:
        """All failures, each with the name of its case."""
        return tuple(f"{case.name}: {failure}" for case in self.cases for failure in case.failures)

    def plain(self) -> dict[str, Any]:
        """The report as JSON holds it, with its sums."""
        return {**asdict(self), "tried": sum(case.tried for case in self.cases), "failed": len(self.failures)}


class UndisturbedError(Exception):
    """A command that fails, or has another result, without any fault, which prevents the trials."""


@dataclass(frozen=True)
class Expected:
    """The reference of an undisturbed run: the folder before it, after it, and after it was repeated.

    `store_before` and `store_after` are what a reader finds in the store (`look`).
    """

    before: dict[str, str]
    after: dict[str, str]
    repeated: dict[str, str]
    store_before: dict[str, Any]
    store_after: dict[str, Any]
    operations: tuple[str, ...]
    seconds: float
    sizes: tuple[int, ...]


class Drill:
    """Makes starting folders once and tries faults in copies of them; owns the folder that it is given."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
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
        making.mkdir(parents=True, exist_ok=True)
        for arguments in commands:
            require_success(run_command(making, arguments), arguments)
        making.rename(path)
        return path

    def prepare(self, scenario: Scenario) -> Expected:
        """Run the command undisturbed, three times: twice from the start, which must agree, and once more."""
        if scenario.name in self.expected:
            return self.expected[scenario.name]
        start, place, ends = self.start_of(scenario.start), self.folder / "place", []
        for _ in range(2):
            copy(start, place)
            before, store_before = tree(place), look(place / scenario.store)
            outcome = self.run(scenario, place)
            require_success(outcome, scenario.command)
            ends.append(tree(place))
        if differing := difference(ends[1], ends[0]):
            raise UndisturbedError(f"{scenario.name} does not give the same twice, without any fault: {differing}")
        store_after = look(place / scenario.store)
        changed = [place / name for name in ends[0] if ends[0][name] != before.get(name)]
        sizes = tuple(path.stat().st_size for path in changed if path.is_file() and path.stat().st_size)
        again = self.run(scenario, place, repeating=True)
        if not refuses(again, scenario):
            require_success(again, scenario.repetition)
        states = (before, ends[0], tree(place), store_before, store_after)
        self.expected[scenario.name] = Expected(*states, outcome.operations, outcome.seconds, sizes)
        return self.expected[scenario.name]

    def attempt(self, scenario: Scenario, fault: Fault) -> str:
        """Try one fault, repeat the command; returns the failure in a line, or nothing."""
        expected = self.prepare(scenario)
        place = self.folder / "place"
        copy(self.start_of(scenario.start), place)
        hit = self.run(scenario, place, fault)
        found = look(place / scenario.store)
        problem = ending_fault(hit, scenario, expected, fault) or state_fault(scenario, expected, place, found)
        if problem:
            return problem
        stored = found == expected.store_after != expected.store_before
        there = tree(place)
        done = stored or all(there.get(name) == digest for name, digest in expected.after.items())
        again = self.run(scenario, place, repeating=True)
        if again.code != 0 and not (done and refuses(again, scenario)):
            return f"repeated, it ends with exit code {again.code}: {again.last_line}"
        end = {name: digest for name, digest in tree(place).items() if not LEFT.fullmatch(name)}
        if end in (expected.after, expected.repeated):
            return ""
        return f"repeated, it ends with another result: {difference(end, expected.after)}"

    def run(self, scenario: Scenario, place: Path, fault: Fault = UNDISTURBED, *, repeating: bool = False) -> Outcome:
        """Run the scenario's command, or its repetition."""
        return run_command(place, scenario.repetition if repeating else scenario.command, fault)


def run(
    seed: int, seconds: float, folder: Path, names: Sequence[str] = tuple(SCENARIOS), most: int | None = None
) -> Report:
    """Try faults in each scenario in turn until all are tried or the time is up.

    `names` chooses scenarios, `most` is how many faults each is tried with at most.
    """
    started, drill = time.perf_counter(), Drill(folder)
    found: dict[str, list[tuple[str, str]]] = {name: [] for name in names}
    waiting = {name: attempts(drill, SCENARIOS[name], seed, most) for name in names}
    if most is None:
        waiting["a file is missing"] = missing(drill)
    while waiting and time.perf_counter() - started < seconds:
        for name in list(waiting):
            try:
                tried = next(waiting[name], None)
            except UndisturbedError as error:
                tried = "undisturbed", str(error)
            if tried is None:
                del waiting[name]
            else:
                found.setdefault(name, []).append(tried)
    cases = tuple(
        Case(name, len(each), tuple(problem for _, problem in each if problem), Counter(kind for kind, _ in each))
        for name, each in found.items()
    )
    return Report("crash", seed, time.perf_counter() - started, cases, environment())


def attempts(drill: Drill, scenario: Scenario, seed: int, most: int | None) -> Iterator[tuple[str, str]]:
    """Try a scenario with its faults in a random order, or with the first few of them: kind, failure."""
    expected = drill.prepare(scenario)
    generator = np.random.default_rng([seed, *scenario.name.encode()])
    found: list[tuple[Fault, str]] = []
    for kind in scenario.modes:
        if kind == "operation":
            found += [(Fault(kind, number), f" ({name})") for number, name in enumerate(expected.operations)]
            continue
        for _ in range(NUM_TRIALS[kind]):
            whole = float(generator.choice(expected.sizes)) if kind in ("bytes", "limit") else expected.seconds
            found.append((Fault(kind, whole * float(generator.random())), ""))
    for index in generator.permutation(len(found))[:most]:
        fault, about = found[index]
        problem = drill.attempt(scenario, fault)
        yield fault.kind, f"{fault}{about}: {problem}" if problem else ""


def missing(drill: Drill) -> Iterator[tuple[str, str]]:
    """Remove each file of a store and a run before commands: all is well, or it is explained; `validate` misses it."""
    start, place = drill.start_of("model"), drill.folder / "place"
    files = sorted(path.relative_to(start).as_posix() for path in start.rglob("*") if path.is_file())
    for name in (each for each in files if each.startswith(("store/", "runs/"))):
        for arguments in MEETING:
            copy(start, place)
            (place / name).unlink()
            outcome = run_command(place, arguments)
            explained = outcome.last_line.startswith("motionkit: ") or "is missing" in outcome.out
            problem = f"exit code {outcome.code}: {outcome.last_line}"
            if outcome.code == 0 or (outcome.code in (1, 2) and explained and not outcome.shows_traceback):
                needed = name.startswith("store/") and not name.startswith("store/cache/") and "lock" not in name
                overlooked = arguments[0] == "validate" and needed and not outcome.code
                problem = "validate does not miss it" if overlooked else ""
            yield arguments[0], f"{name} removed: {problem}" if problem else ""


def state_fault(scenario: Scenario, expected: Expected, place: Path, found: dict[str, Any]) -> str:
    """What is in neither its old nor its new state: the store as a reader sees it, or a file that must be whole."""
    if found not in (expected.store_before, expected.store_after):
        return f"the store {scenario.store} is neither in its old nor in its new state: {json.dumps(found)}"
    there = tree(place)
    for name in sorted({path.relative_to(place).as_posix() for each in scenario.whole for path in place.glob(each)}):
        if not TEMPORARY.search(name) and there[name] not in (expected.before.get(name), expected.after.get(name)):
            return f"{name} is half written"
    return ""


def ending_fault(hit: Outcome, scenario: Scenario, expected: Expected, fault: Fault) -> str:
    """The fault in how a disturbed command ended."""
    codes = CODES[fault.kind]
    if fault.kind == "terminate" and scenario.command[0].startswith(CALL):  # SIGTERM kills a program that is no command
        codes = (*codes, -signal.SIGTERM)
    if hit.code is None:
        return f"it hung: after {hit.seconds:.0f} s it was still running"
    if hit.is_left:
        return "one of its processes was still there ten seconds later"
    if hit.shows_traceback:
        return f"a traceback: {hit.last_line}"
    if hit.code not in codes:
        return f"it ended with exit code {hit.code}: {hit.last_line}"
    written = {name for name, digest in expected.after.items() if expected.before.get(name) != digest}
    folders = {parent.as_posix() for name in written for parent in PurePosixPath(name).parents} - {"."}
    explained = hit.last_line.startswith("motionkit: ") and any(name in hit.last_line for name in written | folders)
    return f"it failed without saying what with: {hit.last_line}" if hit.code == 1 and not explained else ""


def refuses(outcome: Outcome, scenario: Scenario) -> bool:
    """Whether a repeated command says that there is nothing left to do."""
    return bool(scenario.refusal) and outcome.code in (1, 2) and bool(re.search(scenario.refusal, outcome.err))


def require_success(outcome: Outcome, arguments: Arguments) -> None:
    """Raise `UndisturbedError` if an undisturbed command failed."""
    if outcome.code != 0:
        raise UndisturbedError(f"`{' '.join(arguments)}` fails undisturbed ({outcome.code}): {outcome.last_line}")


def tree(folder: Path) -> dict[str, str]:
    """Every file and folder below a folder with a digest of its content, as far as it does not depend on the clock."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        found[name] = f"-> {path.readlink()}" if path.is_symlink() else "/" if path.is_dir() else _digest(path)
    return found


def difference(found: Mapping[str, str], expected: Mapping[str, str]) -> str:
    """The differences of two trees, the first few of each kind; empty if there are none."""
    differing = {name for name in found.keys() & expected.keys() if found[name] != expected[name]}
    left, missing = found.keys() - expected.keys(), expected.keys() - found.keys()
    kinds = {"left over": left, "missing": missing, "different": differing}
    return "; ".join(f"{kind}: {', '.join(sorted(names)[:SHOWN])}" for kind, names in kinds.items() if names)


def copy(source: Path, target: Path) -> None:
    """Copy a folder over whatever was at the target."""
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(source, target, symlinks=True)


def _digest(path: Path) -> str:
    if path.name.endswith(".lock"):
        return "lock"  # it holds the number of a process
    if path.name == "SHA256SUMS":
        return "sums"  # of files that hold times
    content = path.read_bytes()
    try:
        if path.suffix in (".json", ".jsonl"):
            dropped = VOLATILE | {"seconds"} if path.name.endswith(TIMED) else VOLATILE
            documents = [json.loads(part) for part in (content.splitlines() if path.suffix == ".jsonl" else [content])]
            content = json.dumps([_kept(each, dropped) for each in documents], sort_keys=True).encode()
        elif path.suffix == ".safetensors":
            end = 8 + int.from_bytes(content[:8], "little")
            header = json.loads(content[8:end])
            description = json.loads(header.pop("__metadata__")["description"])
            content = json.dumps([header, _kept(description, VOLATILE)], sort_keys=True).encode() + content[end:]
    except (KeyError, ValueError):
        pass  # as it stands
    return hashlib.sha256(content).hexdigest()


def _kept(value: Any, dropped: frozenset[str]) -> Any:
    if isinstance(value, dict):
        return {name: _kept(each, dropped) for name, each in value.items() if name not in dropped}
    return [_kept(each, dropped) for each in value] if isinstance(value, list) else value


def look(path: Path) -> dict[str, Any]:
    """What a reader finds in a store: its fingerprint, a digest of every motion, and `validate`'s faults."""
    if not (path / MANIFEST_FILE).exists():
        return {}
    try:
        store = Store.open(path)
        return {"fingerprint": store.fingerprint, "content": content_of(store), "faults": list(faults(path))}
    except MotionkitError as error:
        return {"unreadable": str(error)}


def content_of(store: Store) -> str:
    """A digest of the content of a store's sequences, independent of its parts and indices."""
    found = hashlib.sha256()
    for motion in store.read_many(store.select()):
        facts = (motion.sequence_id, motion.fps, motion.split, motion.action, motion.captions)
        found.update(repr(facts).encode() + np.ascontiguousarray(motion.joint_positions).tobytes())
    return found.hexdigest()
