"""One fuzzed reader: how its valid sources are made, which of their files are damaged, and how it is called."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

Make = Callable[[Path], object]
Victims = Callable[[Path], Sequence[Path]]


def every_file(source: Path) -> list[Path]:
    """All files of a source, in order."""
    return sorted(path for path in source.rglob("*") if path.is_file())


def named(*patterns: str) -> Victims:
    """The files of a source that one of these patterns matches, in order."""

    def victims(source: Path) -> list[Path]:
        return sorted({path for pattern in patterns for path in source.rglob(pattern) if path.is_file()})

    return victims


@dataclass(frozen=True)
class Target:
    """One reader.

    Each of `makes` writes a small valid source into an empty folder; one file of it, of `victims`, is damaged. `use`
    reads all of the folder as a user would, without catching errors. `sealed` updates the checksum of a damaged file,
    by its path and new content, to reach the code behind the check; `after` restores a source if `use` or `sealed`
    changes more than the damaged file.
    """

    name: str
    makes: tuple[Make, ...]
    use: Callable[[Path], None]
    victims: Victims = every_file
    sealed: Callable[[Path, bytes], bytes] | None = None
    after: Callable[[Path], None] | None = None
