"""Files that are no motions: which ones a source has, and what is said of them."""

from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import islice
from pathlib import Path

from motionkit.core.errors import FormatError
from motionkit.formats.arrays import unknown
from motionkit.formats.catalogue import readers
from motionkit.formats.scan import annotations
from motionkit.formats.scan.items import ReadOptions, ScanResult

# What a folder without motions is said to hold.
SEEN_FILES, SHOWN_KINDS = 1_000, 3


def ignored(files: Iterable[Path], found: Sequence[tuple[Path, ScanResult]], read: Iterable[Path]) -> tuple[Path, ...]:
    """The files that are no sequence, no problem and nothing that belongs to a sequence.

    `found` are the folders of the source with what was found in each, `read` what was read besides.
    """
    known = set(read)
    for folder, result in found:
        known.update(annotations.licence_files(folder))
        known.update(item.path for item in result.items)
        known.update(problem.path for problem in (*result.problems, *result.warnings))
        for name in {item.format for item in result.items}:
            known.update(readers()[name].beside(folder))
    return tuple(path for path in files if path not in known)


def kinds_of(paths: Iterable[Path]) -> dict[str, int]:
    """Number of files by suffix, or by name where there is none; the most frequent first."""
    return dict(Counter(path.suffix.lower() or path.name for path in paths).most_common())


def no_motion(source: Path, options: ReadOptions) -> FormatError:
    """The problem of a file or folder in which nothing is a motion."""
    expected = options.format if options.format != "auto" else ", ".join(readers())
    if source.is_file():
        arrays = unknown.describe(source) if options.format in ("auto", "npz", "joints-npy") else ""
        message = arrays or f"of no known format, expected {expected}"
        return FormatError(message, path=source, reason="unknown-format")
    kinds = kinds_of(islice((path for path in source.rglob("*") if path.is_file()), SEEN_FILES))
    there = ", ".join(f"{count} {kind}" for kind, count in list(kinds.items())[:SHOWN_KINDS]) or "no files"
    message = f"no motions in this folder (it has {there}), expected {expected}"
    return FormatError(message, path=source, reason="empty-folder")
