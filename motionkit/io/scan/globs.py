"""Globs over paths, matched in time proportional to the glob's length times the path's, for any number of wildcards.

A pattern may come from an untrusted file, so no pattern may need exponential time: matching is greedy, each part takes
the first position where it matches, without backtracking (a later position can only leave less room).
"""

import fnmatch
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

# Longer than any path of an operating system.
LONGEST_GLOB = 4096
ANY_FOLDERS = "**"


@dataclass(frozen=True)
class Glob:
    """A glob that matches the end of a path, from the beginning of a folder's or the file's name.

    `runs` are the patterns of consecutive names between two `**/`, in order; the last run ends with the file's name.
    """

    runs: tuple[tuple[re.Pattern[str], ...], ...]

    def fits(self, path: str) -> bool:
        """Whether it matches a path whose names are separated by `/`."""
        names = path.split("/")
        last = len(names) - len(self.runs[-1])
        if last < 0 or not _fit(self.runs[-1], names, last):
            return False
        start = 0
        for run in self.runs[:-1]:
            found = next((place for place in range(start, last - len(run) + 1) if _fit(run, names, place)), None)
            if found is None:
                return False
            start = found + len(run)
        return True


@lru_cache(maxsize=1024)
def parse_glob(text: str) -> Glob:
    """Parse a glob; raises `ValueError` if it is longer than 4,096 characters.

    `*` and `?` match within a name, `**/` any number of folders, `[abc]` one of these letters, `[!abc]` any other one.
    """
    if len(text) > LONGEST_GLOB:
        raise ValueError(f"a glob of {len(text):,} letters, expected at most {LONGEST_GLOB:,}")
    *folders, name = text.split("/")
    runs: list[tuple[re.Pattern[str], ...]] = [()]
    for folder in folders:
        if folder == ANY_FOLDERS:
            runs.append(())
        else:
            runs[-1] += (re.compile(fnmatch.translate(folder)),)
    runs[-1] += (re.compile(fnmatch.translate(name)),)
    return Glob(tuple(run for run in runs if run))


def _fit(run: Sequence[re.Pattern[str]], names: Sequence[str], start: int) -> bool:
    return all(pattern.match(names[start + place]) for place, pattern in enumerate(run))
