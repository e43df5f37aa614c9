"""Hostile stores, runs, samples and tables (tests/hostile): commands must stay in their folder and explain errors.

Each scene is a folder beside another one that must not be touched. A command may refuse the scene or use it; it must
not change anything outside of the scene's folder, end with a traceback, or print control characters.
"""

import hashlib
import os
import re
import shutil
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.trust.corruption.starts import make_start
from benchmarks.trust.process import TIMEOUT_SECONDS, Commands, Outcome
from benchmarks.trust.report import Case, Report
from benchmarks.trust.trees import copy
from benchmarks.trust.trials import shows_traceback
from eval.report.results import environment
from motionkit.store.workers import usable_cores
from tests.hostile import SCENES
from tests.hostile.scene import Arguments, Scene

DEFAULT_SECONDS = 1800.0
SHOWN_CHARACTERS = 240
LONGEST_MESSAGE = 4000
SECRET = "somebody's own"
CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


def run(seed: int, seconds: float, folder: Path) -> Report:
    """Run every command of every scene once, or as many as time allows."""
    return run_scenes(SCENES, seed, folder, seconds=seconds, lanes=usable_cores())


@dataclass
class Tally:
    """Outcomes of a scene's commands."""

    tried: int = 0
    refused: int = 0
    longest_seconds: float = 0.0
    failures: list[str] = field(default_factory=list)

    def add(self, arguments: Arguments, outcome: Outcome, fault: str) -> None:
        """Count a command; `fault` is what was wrong with it, if anything."""
        self.tried += 1
        self.refused += bool(outcome.code)
        self.longest_seconds = max(self.longest_seconds, outcome.seconds)
        self.failures += [f"`{' '.join(arguments)[:60]}`: {fault}"] if fault else []


def run_scenes(
    scenes: Sequence[Scene],
    seed: int,
    folder: Path,
    *,
    seconds: float = float("inf"),
    commands_each: int = 1 << 30,
    lanes: int = 1,
) -> Report:
    """Run so many commands of each of these scenes, in so many processes at once; the seed says which come first."""
    begun = time.monotonic()
    tallies = [Tally() for _ in scenes]
    rounds = min(commands_each, max(len(scene.commands) for scene in scenes))
    with ExitStack() as stack, ThreadPoolExecutor(lanes) as pool:
        servers = [stack.enter_context(Commands()) for _ in range(lanes)]
        good = make_start(servers[0], folder, "everything")

        def work(lane: int) -> None:
            # The first command of every scene, then the second: with too little time, no scene is left out.
            for number in range(rounds):
                for scene, tally in list(zip(scenes, tallies, strict=True))[lane::lanes]:
                    if number < len(scene.commands) and time.monotonic() - begun <= seconds:
                        arguments = scene.commands[(seed + number) % len(scene.commands)]
                        outcome, fault = attempt(servers[lane], scene, arguments, good, folder / f"place-{lane}")
                        tally.add(arguments, outcome, fault)

        list(pool.map(work, range(lanes)))
    cases = tuple(
        Case(
            scene.name,
            tally.tried,
            tuple(tally.failures),
            {"refused": tally.refused, "longest_seconds": round(tally.longest_seconds, 1)},
        )
        for scene, tally in zip(scenes, tallies, strict=True)
    )
    return Report("hostile", seed, time.monotonic() - begun, cases, environment())


def attempt(commands: Commands, scene: Scene, arguments: Arguments, good: Path, place: Path) -> tuple[Outcome, str]:
    """Run one command in a scene; its outcome, and any fault in a line."""
    inside, outside = place / "inside", place / "outside"
    copy(good, inside)
    if not outside.exists():
        _make_outside(good, outside)
    scene.spoil(inside, outside)
    before = snapshot(place, without=inside)
    outcome = commands.run(inside, arguments)
    changed = _changes(before, snapshot(place, without=inside))
    if changed:
        shutil.rmtree(place)
        return outcome, f"outside of its folder: {changed}"
    return outcome, ending_fault(outcome)


def _make_outside(good: Path, outside: Path) -> None:
    copy(good, outside)
    for name in ("mine.txt", "mine.npy", "mine.npz", "mine.png", "folder/sub/mine.txt", "folder/0-smpl22-0/mine.txt"):
        (outside / name).parent.mkdir(parents=True, exist_ok=True)
        (outside / name).write_text(f"{SECRET}\n")


def ending_fault(outcome: Outcome) -> str:
    """The fault in how a command ended or in its output."""
    output = outcome.out + outcome.err
    if outcome.code is None:
        return f"no end within {TIMEOUT_SECONDS:g} s"
    if outcome.left:
        return f"{outcome.left} of its processes were still there ten seconds later"
    if outcome.code not in (0, 1, 2) or shows_traceback(outcome):
        return f"exit {outcome.code}: {outcome.last_line[:SHOWN_CHARACTERS]}"
    # For commands that validate a store or samples, the problems found are the regular output.
    if outcome.code and not outcome.out.strip() and "motionkit: " not in outcome.err:
        return f"exit {outcome.code} without a reason: {outcome.last_line[:SHOWN_CHARACTERS]}"
    longest = max(map(len, outcome.err.splitlines()), default=0)
    if longest > LONGEST_MESSAGE:
        return f"a message of {longest:,} letters: {outcome.err[:SHOWN_CHARACTERS]}"
    control = CONTROL.search(output.replace("\r\n", "\n"))
    if control:
        return f"prints {control[0]!r}: {output[max(0, control.start() - 60) : control.start() + 60]!r}"
    return "shows what lies outside of its folder" if SECRET in output else ""


def snapshot(folder: Path, without: Path) -> dict[str, tuple[object, ...]]:
    """Contents of a folder, without following links: kind, permissions, time of change and digest of each entry."""
    found: dict[str, tuple[object, ...]] = {}
    waiting = [folder]
    while waiting:
        for path in sorted(waiting.pop().iterdir()):
            if path == without:
                continue
            status = path.lstat()
            content = b""
            if path.is_symlink():
                content = os.fsencode(path.readlink())
            elif path.is_dir():
                waiting.append(path)
            else:
                content = path.read_bytes()
            digest = hashlib.sha256(content).hexdigest()
            found[str(path.relative_to(folder))] = (status.st_mode, status.st_mtime_ns, digest)
    return found


def _changes(before: dict[str, tuple[object, ...]], after: dict[str, tuple[object, ...]]) -> str:
    words = []
    for word, names in (
        ("gone", before.keys() - after.keys()),
        ("new", after.keys() - before.keys()),
        ("changed", {name for name in before.keys() & after.keys() if before[name] != after[name]}),
    ):
        words += [f"{word}: {', '.join(sorted(names)[:3])}"] if names else []
    return "; ".join(words)
