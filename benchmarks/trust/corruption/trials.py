"""One flipped byte: run the commands that read the file and judge their results."""

import re
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

from benchmarks.trust.corruption.kinds import Kind
from benchmarks.trust.corruption.starts import make_start
from benchmarks.trust.process import Commands, Outcome
from benchmarks.trust.scenarios import Arguments
from benchmarks.trust.trees import copy, difference, tree

NEAR_BYTES = 512
SHOWN_CHARACTERS = 200
CLOCK = re.compile(r"(?<=seconds )[\d.]+")


@dataclass(frozen=True)
class Flip:
    """One byte of one file that gets another value."""

    path: str
    place: int
    value: int

    def __str__(self) -> str:
        return f"{self.path}, byte {self.place} → 0x{self.value:02x}"

    def apply(self, folder: Path) -> None:
        """Damage the file."""
        content = bytearray((folder / self.path).read_bytes())
        content[self.place] = self.value
        (folder / self.path).write_bytes(content)


def choose_flip(kind: Kind, start: Path, seed: int, number: int) -> Flip:
    """The flip of this number: half of them anywhere, the others near the file's ends, where headers stand."""
    rng = Random(f"{kind.name}/{seed}/{number}")
    paths = sorted(path for path in start.glob(kind.pattern) if path.is_file())
    if not paths:
        raise FileNotFoundError(f"{start / kind.pattern}: there is no such file to damage")
    path = rng.choice(paths)
    content = path.read_bytes()
    near = min(NEAR_BYTES, len(content))
    place = rng.choice(
        (
            rng.randrange(len(content)),
            rng.randrange(len(content)),
            rng.randrange(near),
            len(content) - 1 - rng.randrange(near),
        )
    )
    value = (content[place] + rng.randrange(1, 256)) % 256
    return Flip(path.relative_to(start).as_posix(), place, value)


@dataclass
class Tally:
    """Results of the flips of one kind, by use."""

    tried: int = 0
    detected: int = 0
    harmless: int = 0
    seconds: float = 0.0
    failures: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Expected:
    """The result of a use of undamaged files."""

    printed: str
    after: dict[str, str]


class Trials:
    """Flips bytes in copies of the starting folders that lie in a folder; owns the folder `place` in it."""

    def __init__(self, commands: Commands, folder: Path, place: str) -> None:
        self.commands, self.folder, self.place = commands, folder, folder / place
        self._expected: dict[tuple[str, Arguments], Expected] = {}

    def flip(self, kind: Kind, seed: int, number: int, tally: Tally) -> None:
        """Try one flip with every use of its kind."""
        begun = time.monotonic()
        start = make_start(self.commands, self.folder, kind.start)
        flip = choose_flip(kind, start, seed, number)
        results = [self._judge(kind, start, use, flip) for use in kind.uses]
        faults = [result for result in results if result not in ("detected", "harmless")]
        tally.tried += 1
        tally.failures += [f"{kind.name}:{seed}:{number}: {flip}: {fault}" for fault in faults]
        if not faults:
            tally.detected += "detected" in results
            tally.harmless += "detected" not in results
        tally.seconds += time.monotonic() - begun

    def _judge(self, kind: Kind, start: Path, use: Arguments, flip: Flip) -> str:
        """`detected`, `harmless`, or what is wrong in a line."""
        expected = self._undamaged(kind, start, use)
        place = self.place
        copy(start, place)
        flip.apply(place)
        before = tree(place)
        outcome = self.commands.run(place, use)
        after = tree(place)
        output = f"{outcome.out}\n{outcome.err}"
        command = " ".join(use[:3])
        if outcome.code not in (0, 1, 2) or "Traceback" in output:
            return f"`{command}`: traceback ({_short(outcome)})"
        if outcome.code:
            named = any(name in output for name in _names(flip.path))
            lost = difference({name: after.get(name, "") for name in before}, before)
            if not named:
                return f"`{command}`: not named ({_short(outcome)})"
            return f"`{command}`: detected, but {lost}" if lost else "detected"
        ours = {name: value for name, value in after.items() if name != flip.path}
        differing = difference(ours, {name: value for name, value in expected.after.items() if name != flip.path})
        if _printed(outcome) != expected.printed:
            return f"`{command}`: missed (it prints something else)"
        return f"`{command}`: missed ({differing})" if differing else "harmless"

    def _undamaged(self, kind: Kind, start: Path, use: Arguments) -> Expected:
        key = (kind.start, use)
        if key not in self._expected:
            place, found = self.place, []
            for _ in range(2):
                copy(start, place)
                outcome = self.commands.run(place, use)
                if outcome.code:
                    raise RuntimeError(f"{kind.start}: `{' '.join(use)}` fails with nothing damaged: {_short(outcome)}")
                found.append(Expected(_printed(outcome), tree(place)))
            if found[0] != found[1]:
                differing = difference(found[1].after, found[0].after) or "what it prints"
                raise RuntimeError(f"{kind.start}: `{' '.join(use)}` does not give the same twice: {differing}")
            self._expected[key] = found[0]
        return self._expected[key]


def _printed(outcome: Outcome) -> str:
    """A command's output without times."""
    return CLOCK.sub("", outcome.out)


def _names(path: str) -> Sequence[str]:
    """The file, or a folder that holds it, which the message must name."""
    parts = Path(path).parts
    return (parts[-1], *("/".join(parts[:count]) for count in range(1, len(parts))))


def _short(outcome: Outcome) -> str:
    code = "no end" if outcome.code is None else f"exit {outcome.code}"
    return f"{code}: {outcome.last_line[:SHOWN_CHARACTERS]}"
