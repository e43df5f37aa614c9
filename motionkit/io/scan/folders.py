"""Walking a source: every folder once, following links, safe against loops."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path

from motionkit.core.errors import FormatError
from motionkit.core.files import is_store

HIDDEN = (".", "__")
# Folders of the system, in which links lead everywhere and files have no end.
SYSTEM = tuple(map(Path, ("/proc", "/sys", "/dev")))


def walk(
    root: Path, is_whole: Callable[[Path], bool], on_problem: Callable[[FormatError], None]
) -> Iterator[tuple[Path, list[Path]]]:
    """The folders below `root`, itself first, in sorted order, each with its files; hidden ones are left out.

    A folder that `is_whole` is not entered. Links to folders are followed after all real folders, so that a folder
    reachable both ways gets its real path; folders already visited, those that contain the source, and stores are
    skipped.
    What cannot be listed or looked at (`unreadable`) and useless links (`dangling-link`) go to `on_problem`.
    """
    seen: set[tuple[int, int]] = set()
    starts = [root]
    while starts:
        links: list[Path] = []
        for start in starts:
            waiting = [start]
            while waiting:
                folder = waiting.pop()
                try:
                    status = folder.stat()
                    entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
                except OSError as error:
                    message = f"the folder cannot be listed ({error.strerror or error})"
                    on_problem(FormatError(message, path=folder, reason="unreadable"))
                    continue
                if (status.st_dev, status.st_ino) in seen:
                    continue
                seen.add((status.st_dev, status.st_ino))
                below, linked, files = _sorted_out(folder, entries, on_problem)
                if not is_whole(folder):
                    links += linked
                    waiting += reversed(below)
                yield folder, files
        starts = [link for link in links if not root.is_relative_to(link.resolve())]


def dangling(link: Path) -> FormatError | None:
    """The error of a link that leads nowhere, or into a folder of the system; None for any other entry of a folder."""
    try:
        target = link.readlink()
    except OSError:
        return None
    try:
        link.stat()
        fault = "a folder of the system" if any(link.resolve().is_relative_to(each) for each in SYSTEM) else ""
    except OSError as error:
        fault = f"which leads nowhere ({error.strerror or error})"
    if not fault:
        return None
    return FormatError(f"is a link to {target}, {fault}: fix the link or remove it", path=link, reason="dangling-link")


def _sorted_out(
    folder: Path, entries: list[os.DirEntry[str]], on_problem: Callable[[FormatError], None]
) -> tuple[list[Path], list[Path], list[Path]]:
    # Folders, links to folders, files.
    below: list[Path] = []
    linked: list[Path] = []
    files: list[Path] = []
    for entry in entries:
        if entry.name.startswith("."):
            continue
        path = folder / entry.name
        is_link = entry.is_symlink()
        if is_link and (problem := dangling(path)) is not None:
            on_problem(problem)
            continue
        try:
            if entry.is_file():  # not a pipe, which would block
                files.append(path)
            elif entry.is_dir() and not entry.name.startswith(HIDDEN) and not is_store(path):
                (linked if is_link else below).append(path)
        except OSError as error:
            on_problem(FormatError(f"cannot be read ({error.strerror or error})", path=path, reason="unreadable"))
    return below, linked, files
