"""Finding the sequences of a source, to be read by `formats.scan.reading`.

`scan` only lists names and folders, `read` opens one sequence: so ingest can scan once and read in many processes.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

from motionkit.core.errors import FormatError, UsageError
from motionkit.core.files import is_store
from motionkit.io.catalogue import readers
from motionkit.io.format import Format
from motionkit.io.indexes import search
from motionkit.io.scan import annotations, unread
from motionkit.io.scan.annotations import Annotation, AnnotationTable
from motionkit.io.scan.derived import is_derived
from motionkit.io.scan.folders import dangling, walk
from motionkit.io.scan.items import ReadOptions, ScanResult, SourceItem, Spare
from motionkit.io.source import source_file


def scan(sources: Sequence[Path], options: ReadOptions | None = None) -> ScanResult:
    """Find all sequences of files and folders; faults in a source are returned as `problems`, not raised.

    Raises `UsageError` for an unknown format or a source that is neither a file nor a folder, `FormatError` for an
    invalid `options.captions`.
    """
    options = options or ReadOptions()
    if options.format != "auto" and options.format not in readers():
        raise UsageError(f"unknown format {options.format!r}, expected auto or one of {', '.join(readers())}")
    if options.index is not None:
        seen: list[AnnotationTable] = []
        broken: list[FormatError] = []
        found = search.scan_indexes(sources, options.index, _file_items(options, seen, broken))
        found = replace(
            found,
            problems=(*found.problems, *broken, *(each for table in seen for each in table.problems)),
            warnings=(*found.warnings, *(each for table in seen for each in table.warnings)),
        )
        return _unique(found)
    items: list[SourceItem] = []
    problems: list[FormatError] = []
    warnings: list[FormatError] = []
    ignored: list[Path] = []
    given: list[AnnotationTable] = []
    for source in sources:
        if not source.exists():
            raise UsageError(str(dangling(source) or f"{source} does not exist"))
        if not (source.is_file() or source.is_dir()):
            raise UsageError(f"{source} is neither a file nor a folder")
        if is_store(source):
            raise UsageError(f"{source} is a store, expected motions: 'motionkit merge' joins stores")
        table = annotations.read_annotations(options.captions, _root(source)) if options.captions else None
        given += [table] if table else []
        found = _scan_source(source, options, table)
        if not found.items and not found.problems:
            found = replace(found, problems=(unread.no_motion(source, options),))
        items += found.items
        problems += found.problems
        warnings += found.warnings
        ignored += found.ignored
    problems += _problems_of_given(given, {item.path for item in items})
    warnings += given[0].warnings if given else ()
    return _unique(ScanResult(tuple(items), tuple(problems), tuple(warnings), ignored=tuple(dict.fromkeys(ignored))))


def _file_items(
    options: ReadOptions, seen: list[AnnotationTable], broken: list[FormatError]
) -> Callable[[Path, Path], SourceItem | None]:
    """A function (path, source folder) → the file's motion, with the framerate and licence given beside it.

    Annotation tables beside the files are appended to `seen`, errors of unreadable ones to `broken`.
    """
    candidates = [entry for entry in readers().values() if options.format in ("auto", entry.name)]

    @cache
    def around(folder: Path, root: Path) -> tuple[str, tuple[AnnotationTable, ...]]:
        licence, above = around(folder.parent, root) if folder != root else ("", ())
        tables, not_tables = annotations.tables_in(folder)
        seen.extend(tables)
        broken.extend(not_tables)
        return annotations.find_licence(folder) or licence, (*above, *tables)

    def item_of(path: Path, root: Path) -> SourceItem | None:
        kind = next((entry for entry in candidates if _takes(entry, path)), None)
        if kind is None or kind.keys(path):  # an index does not say which of several
            return None
        licence, tables = around(path.parent, root)
        # Annotations of a whole file need not hold for a stretch of it.
        return replace(_annotate(_file_item(kind, path, root, licence), tables), captions=(), split="")

    return item_of


def _root(source: Path) -> Path:
    return (source if source.is_dir() else source.parent).resolve()


def _scan_source(source: Path, options: ReadOptions, given: AnnotationTable | None) -> ScanResult:
    root = _root(source)
    beside: list[AnnotationTable] = []
    found: list[tuple[Path, ScanResult]] = []
    licences: dict[Path, str] = {}
    lost: list[FormatError] = []
    seen: list[Path] = []
    made: list[Path] = []
    one = [(root, [root / source.name])] if source.is_file() else None
    for folder, files in one or walk(root, _is_claimed, lost.append):
        if options.leave_out_made and one is None:
            files = [path for path in files if not _left_out(path, root, made)]
        licences[folder] = annotations.find_licence(folder) or licences.get(folder.parent, "")
        tables_here, broken = annotations.tables_in(folder, given and given.path)
        beside += tables_here
        found.append((folder, ScanResult((), tuple(broken))))
        found.append((folder, _scan_folder(folder, files, root, licences[folder], options)))
        if source.is_dir():
            seen += _files_below(folder) if _is_claimed(folder) else files
        elif not found[-1][1].items and not found[-1][1].problems:
            found.append((folder, _recognise(root / source.name, licences[folder], options)))
    tables = [*beside, *([given] if given else [])]
    items = [_annotate(item, tables) for _, result in found for item in result.items]
    problems = [problem for _, result in found for problem in result.problems]
    warnings = [warning for _, result in found for warning in result.warnings]
    warnings += [warning for table in beside for warning in table.warnings]
    problems += [problem for table in beside for problem in table.problems]
    problems += lost
    # For a single file, or if nothing is read, rows without a motion are not reported.
    if source.is_dir() and items:
        known = {item.path for item in items}
        rows = [(table, path, row) for table in beside for path, row in table.rows.items()]
        problems += [_no_motion(table, path, row, known) for table, path, row in rows if path not in known]
    captioned = [root] if given is not None and given.has_captions else []
    captioned += [table.path.parent for table in beside if table.has_captions]
    reported = {warning.path for warning in warnings if warning.reason == "no-caption"}
    silent = [item for item in items if not item.captions and item.path not in reported]
    warnings += _made_files(root, made)
    ignored = unread.ignored(seen, found, (table.path.parent.resolve() / table.path.name for table in tables))
    warnings += _motions_without_caption(silent, captioned)
    return ScanResult(tuple(items), tuple(problems), tuple(warnings), ignored=ignored)


def _left_out(path: Path, root: Path, made: list[Path]) -> bool:
    # The source folder's own name is ignored: whoever names a folder of completed clips means them.
    known = any(_takes(entry, path) for entry in readers().values())
    if known and is_derived(path if path.parent != root else Path(path.name)):
        made.append(path)
        return True
    return False


def _made_files(root: Path, made: Sequence[Path]) -> list[FormatError]:
    if not made:
        return []
    which = made[0].name + (" …" if len(made) > 1 else "")
    message = (
        f"{len(made):,} of its files ({which}) were made by 'motionkit complete' or 'motionkit plant' and are left "
        "out: name such files one by one to store them"
    )
    return [FormatError(message, path=root, reason="made")]


def _problems_of_given(tables: Sequence[AnnotationTable], known: set[Path]) -> list[FormatError]:
    # One table was read once for each source; a row is missing if no source has its motion.
    if not tables:
        return []
    found = {row.line for table in tables for path, row in table.rows.items() if path in known}
    rows = [(path, row) for path, row in tables[0].rows.items() if row.line not in found]
    return [*tables[0].problems, *(_no_motion(tables[0], path, row, known) for path, row in rows)]


def _no_motion(table: AnnotationTable, path: Path, row: Annotation, known: set[Path]) -> FormatError:
    # Names without a suffix are the commonest mistake; the motions found have few different suffixes.
    meant = [name for suffix in {each.suffix for each in known} if (name := Path(f"{path}{suffix}")) in known]
    message = f"describes {path.name}, but there is no such motion in the source"
    message += f" (did you mean {meant[0].name}?)" if meant else ""
    return FormatError(message, path=table.path, reason="caption-without-motion", line=row.line)


def _files_below(folder: Path) -> list[Path]:
    return [path for _, files in walk(folder, lambda _: False, lambda _: None) for path in files]


def _is_claimed(folder: Path) -> bool:
    return any(entry.claims is not None and entry.claims(folder) for entry in readers().values())


def _scan_folder(folder: Path, files: Iterable[Path], root: Path, licence: str, options: ReadOptions) -> ScanResult:
    candidates = [entry for entry in readers().values() if options.format in ("auto", entry.name)]
    for entry in candidates:
        if entry.claims is not None and entry.find is not None and entry.claims(folder):
            found = entry.find(folder, root)
            return replace(found, items=tuple(replace(item, licence=item.licence or licence) for item in found.items))
    kinds = ((path, next((entry for entry in candidates if _takes(entry, path)), None)) for path in files)
    return ScanResult(
        tuple(item for path, kind in kinds if kind is not None for item in _file_items_of(kind, path, root, licence))
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


def _recognise(path: Path, licence: str, options: ReadOptions) -> ScanResult:
    # A single file with an uninformative name is recognised by its first bytes.
    try:
        with path.open("rb") as file:
            head = file.read(4096).removeprefix(b"\xef\xbb\xbf")
    except OSError as error:
        return ScanResult((), (source_file.unreadable(path, error),))
    words = next((line.strip() for line in head.splitlines() if line.strip() and not line.startswith(b"#")), b"")
    for entry in readers().values():
        fits = options.format in ("auto", entry.name) and (entry.accepts is None or entry.accepts(path))
        if fits and entry.begins and words.upper().startswith(entry.begins):
            return ScanResult(tuple(_file_items_of(entry, path, path.parent, licence)))
    return ScanResult(())


def _file_item(kind: Format, path: Path, root: Path, licence: str) -> SourceItem:
    relative = path.relative_to(root).as_posix()
    folder, slash, _ = relative.partition("/")
    return SourceItem(
        format=kind.name,
        path=path,
        root=root,
        sequence_id=f"{root.name}/{relative.removesuffix(path.suffix)}",
        source=root.name,
        subset=folder if slash else "",
        licence=licence,
    )


def _file_items_of(kind: Format, path: Path, root: Path, licence: str) -> Iterator[SourceItem]:
    whole = _file_item(kind, path, root, licence)
    for key in kind.keys(path) or ("",):
        yield replace(whole, key=key, sequence_id=f"{whole.sequence_id}/{key}") if key else whole


def _takes(entry: Format, path: Path) -> bool:
    return path.suffix.lower() in entry.suffixes and (entry.accepts is None or entry.accepts(path))


def _annotate(item: SourceItem, tables: Sequence[AnnotationTable]) -> SourceItem:
    # A table nearer to the file comes later and takes precedence, cell by cell; a given one comes last.
    for table in tables:
        row = table.rows.get(item.path)
        if row is not None:
            item = _stated(item, row)
    return item


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


def _motions_without_caption(items: Iterable[SourceItem], folders: Sequence[Path]) -> list[FormatError]:
    message = "has no caption in a source that has captions; kept without one"
    return [
        FormatError(message, path=item.path, reason="no-caption")
        for item in items
        if any(item.path.is_relative_to(folder) for folder in folders)
    ]


def _unique(found: ScanResult) -> ScanResult:
    # Of sequences with the same id, all but the first are spares.
    kept: dict[str, SourceItem] = {}
    spares: list[Spare] = []
    for item in found.items:
        first = kept.setdefault(item.sequence_id, item)
        if first is not item:
            message = (
                f"its id {item.sequence_id!r} is already taken by {first.path.name}; rename the file or its folder"
            )
            spares.append(Spare(item, FormatError(message, path=item.path, reason="duplicate-id")))
    problems = (*found.problems, *(spare.problem for spare in spares))
    return replace(found, items=tuple(kept.values()), problems=problems, spares=tuple(spares))
