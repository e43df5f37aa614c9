"""Finding the sequences of a source, to be read by `motionkit.io.reading`.

`scan` lists folders and reads the beginnings of files whose suffix is ambiguous, `read` reads one sequence: so ingest
can scan once and read in many processes.
"""

import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path

from motionkit.core.errors import FormatError, UsageError
from motionkit.core.files import is_store
from motionkit.io.annotations import AnnotationTable, annotated, read_annotations, tables_in
from motionkit.io.registry import (
    FileHead,
    Format,
    ReadOptions,
    ScanResult,
    SourceItem,
    reader_of,
    readers,
    recognise,
    recognise_folder,
    recognise_unnamed,
)
from motionkit.io.source_file import dangling, unreadable

# Limits of messages about what was not read, and of a licence's line.
SHOWN_KINDS, SHOWN_NAMES, MAX_LICENCE_LINE = 3, 8, 120
# Folders above a single file whose tables may describe it.
LEVELS_ABOVE_A_FILE = 3
# Files that are never loaded; docs/formats.md has the lines that convert them.
REFUSED_SUFFIXES = (".fbx", ".pt", ".pth", ".pkl", ".pickle")
COMPLETED, PLANTED = "completed", "planted"
DERIVED_FOLDER = re.compile(rf"({COMPLETED}|{PLANTED})-[\d.-]+fps")


def scan(sources: Sequence[Path], options: ReadOptions | None = None) -> ScanResult:
    """Find all sequences of files and folders; faults in a source are returned as `problems`, not raised.

    Raises `UsageError` for an unknown format or a source that is neither a file nor a folder, `FormatError` for an
    invalid `options.captions`.
    """
    options = options or ReadOptions()
    if options.format != "auto":
        reader_of(options.format)
    if options.index is not None:
        return _unique(_scan_indexes(sources, options))
    found: list[ScanResult] = []
    given: list[AnnotationTable] = []
    for source in sources:
        if not source.exists():
            raise UsageError(str(dangling(source) or f"{source} does not exist"))
        if not (source.is_file() or source.is_dir()):
            raise UsageError(f"{source} is neither a file nor a folder")
        if is_store(source):
            raise UsageError(f"{source} is a store, expected motions: 'motionkit merge' joins stores")
        given += [read_annotations(options.captions, _root(source))] if options.captions else []
        found.append(_scan_source(source, options, given[-1] if given else None))
    items = tuple(item for each in found for item in each.items)
    problems = [problem for each in found for problem in each.problems]
    warnings = [warning for each in found for warning in each.warnings]
    if given:  # the same table for each source, but for the folder from which its paths count
        problems += (*given[0].problems, *_without_motion(given, {item.path for item in items}))
        warnings += given[0].warnings
    ignored = tuple(dict.fromkeys(path for each in found for path in each.ignored))
    return _unique(ScanResult(items, tuple(problems), tuple(warnings), ignored=ignored))


def walk(
    root: Path, is_whole: Callable[[Path], bool], on_problem: Callable[[FormatError], None]
) -> Iterator[tuple[Path, list[Path]]]:
    """The folders below `root`, itself first, in sorted order, each with its files; hidden ones are left out.

    A folder that `is_whole` is not entered. Links to folders are followed after all real folders, so that a folder
    reachable both ways gets its real path; folders already visited, those that contain the source, and stores are
    skipped. What cannot be listed or looked at (`unreadable`, `dangling-link`) goes to `on_problem`.
    """
    visited: set[tuple[int, int]] = set()
    waiting, links = [root], list[Path]()
    while waiting or links:
        folder = waiting.pop() if waiting else links.pop(0)
        try:
            status = folder.stat()
            entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
        except OSError as error:
            on_problem(unreadable(folder, error))
            continue
        if (status.st_dev, status.st_ino) in visited:
            continue
        visited.add((status.st_dev, status.st_ino))
        below: list[Path] = []
        linked: list[Path] = []
        files: list[Path] = []
        for entry in entries:
            path = folder / entry.name
            try:
                if entry.name.startswith("."):
                    continue
                if entry.is_file():  # not a pipe, which would block
                    files.append(path)
                elif not entry.is_dir():
                    path.stat()  # raises for a link that leads nowhere
                elif entry.name.startswith("__") or is_store(path):
                    continue
                elif not entry.is_symlink():
                    below.append(path)
                elif not root.is_relative_to(path.resolve()):
                    linked.append(path)
            except OSError as error:
                on_problem(unreadable(path, error))
        if not is_whole(folder):
            waiting += reversed(below)
            links += linked
        yield folder, files


class _SideFiles:
    """Annotation tables and licence files, folder by folder; owns what it has read."""

    def __init__(self, root: Path, top: Path, given: AnnotationTable | None) -> None:
        self._root, self._top, self._given = root, top, given
        self._of_folder: dict[Path, tuple[str, tuple[AnnotationTable, ...]]] = {}
        self.tables: list[AnnotationTable] = []
        self.problems: list[FormatError] = []

    def of(self, folder: Path) -> tuple[str, tuple[AnnotationTable, ...]]:
        """The licence of a folder, and the tables that may describe its files: the given one last, its own before."""
        if folder in self._of_folder:
            return self._of_folder[folder]
        given = () if self._given is None else (self._given,)
        licence, above = ("", given) if folder == self._top else self.of(folder.parent)
        tables, problems = tables_in(folder, None if self._given is None else self._given.path)
        if folder.is_relative_to(self._root):
            licence = find_licence(folder) or licence
            self.tables += tables
            self.problems += (*problems, *(problem for table in tables for problem in table.problems))
        self._of_folder[folder] = licence, (*above[: len(above) - len(given)], *tables, *given)
        return self._of_folder[folder]


def _root(source: Path) -> Path:
    return (source if source.is_dir() else source.parent).resolve()


def _scan_source(source: Path, options: ReadOptions, given: AnnotationTable | None) -> ScanResult:
    root, is_folder = _root(source), source.is_dir()
    # A single file may be described by a table higher up: not only by one of its folder.
    top = root if is_folder else [root, *root.parents][:LEVELS_ABOVE_A_FILE][-1]
    side_files = _SideFiles(root, top, given)
    items: list[SourceItem] = []
    problems: list[FormatError] = []
    warnings: list[FormatError] = []
    others: list[Path] = []
    derived: list[Path] = []
    data_set = cache(lambda folder: recognise_folder(folder, options.format))
    folders = walk(root, lambda folder: data_set(folder) is not None, problems.append)
    for folder, files in folders if is_folder else [(root, [root / source.name])]:
        licence, tables = side_files.of(folder)
        heads = [FileHead(path) for path in files]
        is_known = not is_folder and recognise(heads[0], options.format) is not None
        kind = None if is_known else data_set(folder)
        if kind is not None and kind.find is not None:
            found = kind.find(folder, root)
            of_source = [each for each in found.items if is_folder or each.path == files[0]]
            items += (annotated(replace(each, licence=each.licence or licence), tables) for each in of_source)
            problems += (each for each in found.problems if is_folder or each.path == files[0])
            warnings += (each for each in found.warnings if is_folder or each.path == files[0])
            continue
        for head in heads:
            path = head.path
            kind = recognise(head, options.format) or (None if is_folder else recognise_unnamed(head, options.format))
            if kind is None:
                others.append(path)
            # The source folder's own name is ignored: whoever names a folder of completed clips means them.
            elif options.skip_derived and is_folder and is_derived(path if folder != root else Path(path.name)):
                derived.append(path)
            else:
                of_file = _items_of_file(kind, head, root, licence)
                items += (annotated(each, tables) for each in of_file) if tables else of_file
    problems += side_files.problems
    if is_folder and items:  # of a single file, other rows are not expected
        problems += _without_motion(side_files.tables, {item.path for item in items})
    if not items and not problems:
        problems.append(_no_motion(source, others, options))
    warnings += (warning for table in side_files.tables for warning in table.warnings)
    if derived:
        which = derived[0].name + (" …" if len(derived) > 1 else "")
        message = f"{len(derived):,} of its files ({which}) were made by 'motionkit complete' or 'motionkit plant' and "
        message += "are left out: name such files one by one to store them"
        warnings.append(FormatError(message, path=root, reason="made"))
    warnings += _without_caption(items, side_files, {warning.path for warning in warnings})
    known = {problem.path for problem in problems} | {table.path for table in side_files.tables}
    known |= set() if given is None else {given.path.parent.resolve() / given.path.name}
    formats = {item.format for item in items}
    ignored = [path for path in others if is_folder and path not in known and not _belongs(path, formats)]
    return ScanResult(tuple(items), tuple(problems), tuple(warnings), ignored=tuple(ignored))


def _items_of_file(kind: Format, head: FileHead, root: Path, licence: str) -> Iterator[SourceItem]:
    relative = head.path.relative_to(root).as_posix()
    folder, slash, _ = relative.partition("/")
    whole = SourceItem(
        format=kind.name,
        path=head.path,
        root=root,
        sequence_id=f"{root.name}/{relative.removesuffix(head.path.suffix)}",
        source=root.name,
        subset=folder if slash else "",
        licence=licence,
    )
    for key in kind.keys(head) or ("",):
        yield replace(whole, key=key, sequence_id=f"{whole.sequence_id}/{key}") if key else whole


def _without_motion(tables: Sequence[AnnotationTable], known: set[Path]) -> Iterator[FormatError]:
    # One table may have been read once for each source: a row is without a motion if no source has it.
    reported = {(table.path, row["line"]) for table in tables for path, row in table.rows.items() if path in known}
    suffixes = {path.suffix for path in known}
    for table in tables:
        for path, row in table.rows.items():
            if (table.path, row["line"]) in reported:
                continue
            reported.add((table.path, row["line"]))
            # Names without a suffix are the commonest mistake.
            meant = next((name for each in suffixes if (name := Path(f"{path}{each}")) in known), None)
            message = f"describes {path.name}, but there is no such motion in the source"
            message += f" (did you mean {meant.name}?)" if meant else ""
            yield FormatError(message, path=table.path, reason="caption-without-motion", line=row["line"])


def _without_caption(items: Iterable[SourceItem], side_files: _SideFiles, reported: set[Path]) -> Iterator[FormatError]:
    for item in items:
        if item.captions or item.path in reported:
            continue
        _, tables = side_files.of(item.path.parent)
        if any(table.has_captions for table in tables):
            message = "has no caption in a source that has captions; kept without one"
            yield FormatError(message, path=item.path, reason="no-caption")


def derived_folder(fps: str, made: str = COMPLETED) -> str:
    """The name of the folder for completed or planted arrays of a framerate, beside their sources."""
    return f"{made}-{fps.replace('/', '-')}fps"


def is_derived(path: Path) -> bool:
    """Whether `complete` or `plant` wrote a file, by its name or its folder's: `walk.completed.bvh`."""
    name = path.name.rpartition(".")[0] if path.suffix else path.name
    return name.endswith((f".{COMPLETED}", f".{PLANTED}")) or DERIVED_FOLDER.fullmatch(path.parent.name) is not None


def find_licence(folder: Path) -> str:
    """First line of the folder's licence file (the files' names if there are several); empty if there is none."""
    files = sorted(entry for entry in folder.iterdir() if entry.name.upper().startswith(("LICENSE", "LICENCE")))
    lines = dict.fromkeys(line for entry in files if entry.is_file() if (line := _first_line(entry)))
    return next(iter(lines)) if len(lines) == 1 else ", ".join(entry.name for entry in files)


def _first_line(path: Path) -> str:
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            lines = file.read(4096).splitlines()
    except OSError:
        return ""
    return next((" ".join(line.split())[:MAX_LICENCE_LINE] for line in lines if line.strip()), "")


def _belongs(path: Path, formats: Iterable[str]) -> bool:
    """Whether a file that is no sequence belongs to sequences of these formats, or states their licence."""
    name = path.name.lower()
    patterns = ("licen[cs]e*", *(pattern.lower() for each in formats for pattern in reader_of(each).beside))
    return any(fnmatchcase(name, pattern) for pattern in patterns)


def _no_motion(source: Path, others: Sequence[Path], options: ReadOptions) -> FormatError:
    expected = options.format if options.format != "auto" else ", ".join(readers())
    if any(path.suffix.lower() in REFUSED_SUFFIXES for path in (source, *others)):
        expected += "; docs/formats.md#fbx-and-pickles converts FBX files and pickles"
    if source.is_file():
        message = f"of no known format{_arrays_of(FileHead(source))}, expected {expected}"
        return FormatError(message, path=source, reason="unknown-format")
    kinds = Counter(path.suffix.lower() or path.name for path in others).most_common(SHOWN_KINDS)
    there = ", ".join(f"{count:,} {kind}" for kind, count in kinds)
    there += f", the first: {others[0].relative_to(source.resolve())}" if others else "no files"
    message = f"no motions in this folder (it has {there}), expected {expected}"
    return FormatError(message, path=source, reason="empty-folder")


def _arrays_of(head: FileHead) -> str:
    if head.array_names:
        names = sorted(head.array_names)
        return f" (an archive of {', '.join(names[:SHOWN_NAMES])}{', …' if len(names) > SHOWN_NAMES else ''})"
    return f" (an array of shape {head.array_shape})" if head.array_shape is not None else ""


def _scan_indexes(sources: Sequence[Path], options: ReadOptions) -> ScanResult:
    """The sequences of indexes, with what tables beside their files say of whole files: no captions and splits."""
    from motionkit.io.indexes import scan_indexes

    assert options.index is not None
    roots: dict[Path, _SideFiles] = {}

    def item_of(path: Path, root: Path) -> SourceItem | None:
        head = FileHead(path)
        kind = recognise(head, options.format)
        if kind is None or kind.keys(head):  # an index does not say which of several
            return None
        licence, tables = roots.setdefault(root, _SideFiles(root, root, None)).of(path.parent)
        (item,) = _items_of_file(kind, head, root, licence)
        return replace(annotated(item, tables), captions=(), split="")

    found = scan_indexes(sources, options.index, item_of)
    problems, warnings = list(found.problems), list(found.warnings)
    for side_files in roots.values():
        problems += side_files.problems
        warnings += (warning for table in side_files.tables for warning in table.warnings)
    return replace(found, problems=tuple(problems), warnings=tuple(warnings))


def _unique(found: ScanResult) -> ScanResult:
    # Of sequences with the same id, only the first is read.
    kept: dict[str, SourceItem] = {}
    problems = list(found.problems)
    for item in found.items:
        first = kept.setdefault(item.sequence_id, item)
        if first is not item:
            message = f"its id {item.sequence_id!r} is already taken by {first.path.name}; rename it or its folder"
            problems.append(FormatError(message, path=item.path, reason="duplicate-id"))
    return replace(found, items=tuple(kept.values()), problems=tuple(problems))
