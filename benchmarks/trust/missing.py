"""Files that are removed under a reader or before a command, and a store on a disk that cannot be written to."""

from collections.abc import Callable, Iterator
from pathlib import Path

from benchmarks.trust.faults import Fault
from benchmarks.trust.process import Outcome
from benchmarks.trust.scenarios import CALL, EVAL, RUN, STORE, Arguments, train
from benchmarks.trust.trees import copy
from benchmarks.trust.trials import Attempt, Drill, shows_traceback

START = "model"
STORE_FILES, ALL_FILES = ("store",), ("store", "runs")
COMMANDS: tuple[Arguments, ...] = (
    ("validate", *STORE),
    ("export", "out", "--format", "npz", *STORE),
    (*train("field"), "--resume"),
    (*train("denoiser"), "--overwrite"),
    ("generate", "--action", "walk", "--fps", "30", "--seconds", "1", "--out", "made", *RUN),
)


def removed_under_a_reader(drill: Drill) -> Iterator[Attempt]:
    """Open the store and its cache, remove one file, read everything: it succeeds, or the error names the file."""
    for name in files_of(drill.start_of(START), STORE_FILES):
        place = drill.folder / "place"
        copy(drill.start_of(START), place)
        outcome = drill.commands.run(place, (f"{CALL}read_without", "store", name))
        yield Attempt("under a reader", f"{name} removed", fault_of(outcome))


def removed_before_a_command(drill: Drill) -> Iterator[Attempt]:
    """Remove one file, run a command: it succeeds, or explains the error; `validate` names a file that is needed."""
    start = drill.start_of(START)
    for name in files_of(start, ALL_FILES):
        for arguments in COMMANDS:
            place = drill.folder / "place"
            copy(start, place)
            (place / name).unlink()
            outcome = drill.commands.run(place, arguments)
            problem = fault_of(outcome)
            if arguments[0] == "validate" and is_committed(name) and outcome.code == 0:
                problem = "validate does not miss it"
            yield Attempt(arguments[0], f"{name} removed, {' '.join(arguments[:3])}", problem)


def read_only_store(drill: Drill) -> Iterator[Attempt]:
    """Run all read-only commands on a store on a read-only disk: they succeed, with the caches in another folder."""
    if drill.disk is None:
        return
    # A store of its own, since other trials are interleaved.
    there, place = drill.disk.path / "read-only", drill.folder / "writable"
    copy(drill.start_of("corpus"), there)
    place.mkdir()
    for arguments in reading(("--store", str((there / "store").absolute()))):
        with drill.disk.suffering(Fault("read-only")):
            outcome = drill.commands.run(place, arguments, environment={"MOTIONKIT_CACHE": "caches"})
        problem = fault_of(outcome) or (f"exit code {outcome.code}: {outcome.last_line}" if outcome.code else "")
        yield Attempt(arguments[0], " ".join(arguments[:3]), problem)


def reading(store: Arguments) -> Iterator[Arguments]:
    """Commands that write nothing to their store."""
    yield from (("info", *store), ("validate", *store), ("query", "SELECT count(*) FROM sequences", *store))
    yield ("export", "out", "--format", "npz", *store)
    yield ("merge", "copy", store[1])
    for stage in ("codebook", "field", "denoiser", "evaluator", "pahires"):
        yield tuple(store[1] if word == STORE[1] else word for word in train(stage))
    yield tuple(store[1] if word == STORE[1] else word for word in ("eval", "--table", "4", "--clips", "64", *EVAL))


MISSING: dict[str, Callable[[Drill], Iterator[Attempt]]] = {
    "a file removed under a reader": removed_under_a_reader,
    "a file removed before a command": removed_before_a_command,
    "a store on a read-only disk": read_only_store,
}


def files_of(start: Path, folders: tuple[str, ...]) -> list[str]:
    """Names of all files in some of the folders."""
    found = [path for folder in folders for path in (start / folder).rglob("*") if path.is_file()]
    return sorted(path.relative_to(start).as_posix() for path in found)


def is_committed(name: str) -> bool:
    """Whether a file is of the store itself: not of its cache, and no lock."""
    return name.startswith("store/") and not name.startswith("store/cache/") and not name.endswith(".lock")


def fault_of(outcome: Outcome) -> str:
    """The fault in how a command with a missing file ended."""
    if shows_traceback(outcome):
        return f"a traceback: {outcome.last_line}"
    if outcome.code not in (0, 1, 2):
        return f"exit code {outcome.code}: {outcome.last_line}"
    explained = outcome.last_line.startswith("motionkit: ") or "is missing" in outcome.out
    return "" if outcome.code == 0 or explained else f"exit code {outcome.code} without a message: {outcome.last_line}"
