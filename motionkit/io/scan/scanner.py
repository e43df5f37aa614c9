"""Finding the sequences of a source, to be read by `formats.scan.reading`.

`scan` lists folders and reads the beginnings of files whose suffix is ambiguous, `read` reads one sequence: so ingest
can scan once and read in many processes.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path

from motionkit.core.errors import FormatError, UsageError
from motionkit.core.files import is_store
from motionkit.io.catalogue import readers, recognise, recognise_unnamed
from motionkit.io.format import FileHead, Format
from motionkit.io.indexes import search
from motionkit.io.scan import annotations
from motionkit.io.scan.annotations import Annotation, AnnotationTable
from motionkit.io.scan.derived import is_derived
from motionkit.io.scan.folders import dangling, walk
from motionkit.io.scan.items import ReadOptions, ScanResult, SourceItem

# Formats with a recipe in docs/formats.md, and limits of messages about what was not read.
CONVERTED = (".fbx", ".pkl", ".pickle", ".pt", ".pth")
SHOWN_KINDS, SHOWN_NAMES = 3, 8


def scan(sources: Sequence[Path], options: ReadOptions | None = None) -> ScanResult:
    """Find all sequences of files and folders; faults in a source are returned as `problems`, not raised.

    Raises `UsageError` for an unknown format or a source that is neither a file nor a folder, `FormatError` for an
    invalid `options.captions`.
    """
    options = options or ReadOptions()
    if options.format != "auto" and options.format not in readers():
        raise UsageError(f"unknown format {options.format!r}, expected auto or one of {', '.join(readers())}")
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
        given += [annotations.read_annotations(options.captions, _root(source))] if options.captions else []
        found.append(_scan_source(source, options, given[-1] if given else None))
    result = ScanResult(
        items=tuple(item for each in found for item in each.items),
        problems=(
            *(problem for each in found for problem in each.problems),
            *(given[0].problems if given else ()),
            *_without_motion(given, {item.path for each in found for item in each.items}),
        ),
        warnings=(*(warning for each in found for warning in each.warnings), *(given[0].warnings if given else ())),
        ignored=tuple(dict.fromkeys(path for each in found for path in each.ignored)),
    )
    return _unique(result)


def _root(source: Path) -> Path:
    return (source if source.is_dir() else source.parent).resolve()


def _scan_source(source: Path, options: ReadOptions, given: AnnotationTable | None) -> ScanResult:
    root, is_folder = _root(source), source.is_dir()
    items: list[SourceItem] = []
    problems: list[FormatError] = []
    warnings: list[FormatError] = []
    tables: list[AnnotationTable] = []
    licences: dict[Path, str] = {}
    others: list[Path] = []
    derived: list[Path] = []
    claim = cache(lambda folder: claiming(folder, options.format))
    folders = walk(root, lambda folder: claim(folder) is not None, problems.append)
    for folder, files in folders if is_folder else [(root, [root / source.name])]:
        licences[folder] = annotations.find_licence(folder) or licences.get(folder.parent, "")
        tables_here, broken = annotations.tables_in(folder, None if given is None else given.path)
        tables += tables_here
        problems += broken
        kind = claim(folder)
        if kind is not None and kind.find is not None:
            found = kind.find(folder, root)
            items += [replace(item, licence=item.licence or licences[folder]) for item in found.items]
            problems += found.problems
            warnings += found.warnings
            continue
        for path in files:
            head = FileHead(path)
            kind = recognise(head, options.format) or (None if is_folder else recognise_unnamed(head, options.format))
            if kind is None:
                others.append(path)
            # The source folder's own name is ignored: whoever names a folder of completed clips means them.
            elif options.skip_derived and is_folder and is_derived(path if folder != root else Path(path.name)):
                derived.append(path)
            else:
                items += _items_of_file(kind, head, root, licences[folder])
    problems += [problem for table in tables for problem in table.problems]
    if is_folder and items:  # of a single file, other rows are not expected
        problems += _without_motion(tables, {item.path for item in items})
    if not items and not problems:
        problems.append(_no_motion(source, others, options))
    items = list(_annotated(items, tables if given is None else [*tables, given]))
    warnings += [warning for table in tables for warning in table.warnings]
    warnings += _derived_files(root, derived)
    captioned = {table.path.parent for table in tables if table.has_captions}
    captioned |= {root} if given is not None and given.has_captions else set()
    warnings += _without_caption(items, captioned, root, {warning.path for warning in warnings})
    known = {problem.path for problem in problems} | {table.path for table in tables}
    known |= set() if given is None else {given.path.parent.resolve() / given.path.name}
    formats = {item.format for item in items}
    ignored = [path for path in others if is_folder and path not in known and not _belongs(path, formats)]
    return ScanResult(tuple(items), tuple(problems), tuple(warnings), ignored=tuple(ignored))


def claiming(folder: Path, name: str = "auto") -> Format | None:
    """The format whose data set a folder is, None for any other folder; `name` allows only one format."""
    kinds = (each for each in readers().values() if name in ("auto", each.name))
    return next((each for each in kinds if each.claims is not None and each.claims(folder)), None)


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


def _annotated(items: Iterable[SourceItem], tables: Sequence[AnnotationTable]) -> Iterator[SourceItem]:
    """The items with what all tables state of their files; a later table takes precedence, column by column."""
    rows: dict[Path, list[Annotation]] = {}
    for table in tables:
        for path, row in table.rows.items():
            rows.setdefault(path, []).append(row)
    for item in items:
        for row in rows.get(item.path, ()):
            item = _stated(item, row)
        yield item


def _stated(item: SourceItem, row: Annotation) -> SourceItem:
    return replace(
        item,
        captions=row.captions or item.captions,
        action=row.action or item.action,
        style=row.style or item.style,
        subject=row.subject or item.subject,
        split=row.split or item.split,
        fps=row.fps or item.fps,
        stated_fps=row.stated_fps or item.stated_fps,
        skip_frames=item.skip_frames if row.skip_frames is None else row.skip_frames,
        licence=row.licence or item.licence,
        source=row.source or item.source,
        # The folder's name is not a subset of a source that the row gives.
        subset=row.subset or ("" if row.source else item.subset),
    )


def with_tables_above(item: SourceItem, levels: int = 4) -> SourceItem:
    """The item of a single file with annotations from the nearest table above it: `scan` uses only those beside it.

    Unreadable tables are ignored.
    """
    for folder in item.path.parents[:levels]:
        for table in annotations.tables_in(folder)[0]:
            if item.path in table.rows:
                return _stated(item, table.rows[item.path])
    return item


def _without_motion(tables: Sequence[AnnotationTable], known: set[Path]) -> Iterator[FormatError]:
    # One table may have been read once for each source: a row is without a motion if no source has it.
    described = {(table.path, row.line) for table in tables for path, row in table.rows.items() if path in known}
    suffixes = {path.suffix for path in known}
    reported = set(described)
    for table in tables:
        for path, row in table.rows.items():
            if (table.path, row.line) in reported:
                continue
            reported.add((table.path, row.line))
            # Names without a suffix are the commonest mistake.
            meant = next((name for each in suffixes if (name := Path(f"{path}{each}")) in known), None)
            message = f"describes {path.name}, but there is no such motion in the source"
            message += f" (did you mean {meant.name}?)" if meant else ""
            yield FormatError(message, path=table.path, reason="caption-without-motion", line=row.line)


def _without_caption(
    items: Iterable[SourceItem], folders: set[Path], root: Path, reported: set[Path]
) -> Iterator[FormatError]:
    """Warnings of the motions below `folders`, whose tables have captions, that have none."""

    @cache
    def has_captions(folder: Path) -> bool:
        return folder in folders or (folder != root and has_captions(folder.parent))

    message = "has no caption in a source that has captions; kept without one"
    for item in items:
        if not item.captions and item.path not in reported and has_captions(item.path.parent):
            yield FormatError(message, path=item.path, reason="no-caption")


def _derived_files(root: Path, derived: Sequence[Path]) -> Iterator[FormatError]:
    if derived:
        which = derived[0].name + (" …" if len(derived) > 1 else "")
        message = (
            f"{len(derived):,} of its files ({which}) were made by 'motionkit complete' or 'motionkit plant' and are "
            "left out: name such files one by one to store them"
        )
        yield FormatError(message, path=root, reason="made")


def _belongs(path: Path, formats: Iterable[str]) -> bool:
    """Whether a file that is no sequence belongs to sequences of these formats, or states their licence."""
    name = path.name.lower()
    patterns = ("licen[cs]e*", *(pattern.lower() for each in formats for pattern in readers()[each].beside))
    return any(fnmatchcase(name, pattern) for pattern in patterns)


def _no_motion(source: Path, others: Sequence[Path], options: ReadOptions) -> FormatError:
    expected = options.format if options.format != "auto" else ", ".join(readers())
    if source.is_file():
        message = f"of no known format{_arrays_of(FileHead(source))}, expected {expected}"
        message += "; docs/formats.md says how to convert it" if source.suffix.lower() in CONVERTED else ""
        return FormatError(message, path=source, reason="unknown-format")
    kinds = kinds_of(others)
    there = ", ".join(f"{count:,} {kind}" for kind, count in list(kinds.items())[:SHOWN_KINDS])
    there += f", the first: {others[0].relative_to(source.resolve())}" if others else "no files"
    message = f"no motions in this folder (it has {there}), expected {expected}"
    return FormatError(message, path=source, reason="empty-folder")


def _arrays_of(head: FileHead) -> str:
    if head.array_names:
        names = sorted(head.array_names)
        return f" (an archive of {', '.join(names[:SHOWN_NAMES])}{', …' if len(names) > SHOWN_NAMES else ''})"
    return f" (an array of shape {head.array_shape})" if head.array_shape is not None else ""


def kinds_of(paths: Iterable[Path]) -> dict[str, int]:
    """Number of files by suffix, or by name where there is none; the most frequent first."""
    return dict(Counter(path.suffix.lower() or path.name for path in paths).most_common())


def _scan_indexes(sources: Sequence[Path], options: ReadOptions) -> ScanResult:
    """The sequences of indexes, with what tables beside their files say of whole files: no captions and splits."""
    assert options.index is not None
    problems: list[FormatError] = []
    tables: list[AnnotationTable] = []

    @cache
    def around(folder: Path, root: Path) -> tuple[str, tuple[AnnotationTable, ...]]:
        licence, above = around(folder.parent, root) if folder != root else ("", ())
        here, broken = annotations.tables_in(folder)
        tables.extend(here)
        problems.extend(broken)
        return annotations.find_licence(folder) or licence, (*above, *here)

    def item_of(path: Path, root: Path) -> SourceItem | None:
        head = FileHead(path)
        kind = recognise(head, options.format)
        if kind is None or kind.keys(head):  # an index does not say which of several
            return None
        licence, near = around(path.parent, root)
        (item,) = _annotated(_items_of_file(kind, head, root, licence), near)
        return replace(item, captions=(), split="")

    found = search.scan_indexes(sources, options.index, item_of)
    return replace(
        found,
        problems=(*found.problems, *problems, *(each for table in tables for each in table.problems)),
        warnings=(*found.warnings, *(each for table in tables for each in table.warnings)),
    )


def _unique(found: ScanResult) -> ScanResult:
    # Of sequences with the same id, only the first is read.
    kept: dict[str, SourceItem] = {}
    problems = list(found.problems)
    for item in found.items:
        first = kept.setdefault(item.sequence_id, item)
        if first is not item:
            message = (
                f"its id {item.sequence_id!r} is already taken by {first.path.name}; rename the file or its folder"
            )
            problems.append(FormatError(message, path=item.path, reason="duplicate-id"))
    return replace(found, items=tuple(kept.values()), problems=tuple(problems))
