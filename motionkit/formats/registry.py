"""Finding the sequences of a source, and reading one.

`scan` looks at names and folders only, `read` opens one sequence: so ingest can scan once and read in many processes.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cache, lru_cache
from pathlib import Path

from motionkit.errors import FormatError, UsageError
from motionkit.formats import annotations, cuts, framerate_rules
from motionkit.formats.annotations import Annotation, AnnotationTable
from motionkit.formats.catalogue import FORMATS, Format
from motionkit.formats.folders import walk
from motionkit.formats.indexes import search
from motionkit.formats.items import ReadOptions, ScanResult, SourceItem
from motionkit.mirror import mirror
from motionkit.motion import Motion
from motionkit.skeleton_families import with_layout_map

__all__ = ["FORMATS", "Format", "ReadOptions", "ScanResult", "SourceItem", "read", "scan"]

# Reasons for which a file is refused where only its framerate is missing or unusable.
NO_FRAMERATE = frozenset({"no-framerate", "framerate", "frame-time"})


def scan(sources: Sequence[Path], options: ReadOptions | None = None) -> ScanResult:
    """Find all sequences of files and folders; nothing bad in a source raises, it becomes one of the `problems`.

    Raises `UsageError` for an unknown format or a source that is neither a file nor a folder, `FormatError` for
    `options.captions` that are no such table.
    """
    options = options or ReadOptions()
    if options.format != "auto" and options.format not in FORMATS:
        raise UsageError(f"unknown format {options.format!r}, expected auto or one of {', '.join(FORMATS)}")
    if options.index is not None:
        of_tables: list[FormatError] = []
        found = search.scan_indexes(sources, options.index, _file_items(options, of_tables))
        kept, duplicates = _unique(found.items)
        return replace(found, items=kept, problems=(*found.problems, *of_tables, *duplicates))
    items: list[SourceItem] = []
    problems: list[FormatError] = []
    warnings: list[FormatError] = []
    given: list[AnnotationTable] = []
    for source in sources:
        if not source.exists():
            raise UsageError(f"{source} does not exist")
        if not (source.is_file() or source.is_dir()):
            raise UsageError(f"{source} is neither a file nor a folder")
        table = annotations.read_annotations(options.captions, _root(source)) if options.captions else None
        given += [table] if table else []
        found = _scan_source(source, options, table)
        if not found.items and not found.problems:
            found = replace(found, problems=(_nothing(source, options),))
        items += found.items
        problems += found.problems
        warnings += found.warnings
    problems += _problems_of_given(given, {item.path for item in items})
    kept, duplicates = _unique(items)
    return ScanResult(kept, (*problems, *duplicates), tuple(warnings))


def read(item: SourceItem, options: ReadOptions | None = None) -> Motion:
    """Read one sequence with its annotations; raises `FormatError`."""
    options = options or ReadOptions()
    if options.fps is None and item.fps is not None:
        options = replace(options, fps=item.fps)
    if item.cut is None and not item.mirrored:
        motion = _read_file(item, options)
        motion = replace(motion, captions=item.captions or motion.captions)
    else:
        motion = _read_stretch(item, options)
    provenance = replace(
        motion.provenance,
        source=item.source,
        subset=item.subset,
        source_path=item.path.relative_to(item.root).as_posix(),
        licence=item.licence or motion.provenance.licence,
        subject=item.subject or motion.provenance.subject,
        stated_fps=item.stated_fps or motion.provenance.stated_fps,
    )
    return replace(
        motion,
        skeleton=with_layout_map(motion.skeleton, options.skeleton_maps),
        sequence_id=item.sequence_id,
        action=item.action or motion.action,
        style=item.style or motion.style,
        split=item.split or motion.split,
        provenance=provenance,
    )


def _read_file(item: SourceItem, options: ReadOptions) -> Motion:
    # All of a file, its framerate corrected by a rule unless the user has given one.
    if options.fps is not None:
        return FORMATS[item.format].read(item, options)
    rules = framerate_rules.matching_rules(item.path, item.root, (*options.fps_rules, *framerate_rules.shipped_rules()))
    try:
        motion = FORMATS[item.format].read(item, options)
    except FormatError as problem:
        rule = next((rule for rule in rules if rule.stated is None), None)
        if rule is None or problem.reason not in NO_FRAMERATE:
            raise
        motion = FORMATS[item.format].read(item, replace(options, fps=rule.fps))
        return motion.logged(f"framerate by rule ({rule.where})")
    return framerate_rules.corrected(motion, rules)


def _read_stretch(item: SourceItem, options: ReadOptions) -> Motion:
    whole = SourceItem(item.format, item.path, item.root, sequence_id="", key=item.key, fps=item.fps)
    motion = _read_once(whole, options, _version(item.path))
    motion = replace(motion, captions=item.captions or motion.captions)
    if item.cut is not None:
        motion = cuts.crop(motion, item.cut, item.path)
    if not item.mirrored:
        return motion
    try:
        return mirror(motion)
    except ValueError as error:
        raise FormatError(f"cannot be mirrored: {error}", path=item.path, reason="mirror") from None


@lru_cache(maxsize=1)
def _read_once(whole: SourceItem, options: ReadOptions, version: tuple[int, int]) -> Motion:
    # The stretches of a file follow each other, and reading a file costs far more than cutting it. A file that has
    # changed since is read again.
    return _read_file(whole, options)


def _version(path: Path) -> tuple[int, int]:
    try:
        status = path.stat()
    except OSError:
        return 0, 0  # the reader will say so
    return status.st_mtime_ns, status.st_size


def _file_items(options: ReadOptions, of_tables: list[FormatError]) -> Callable[[Path, Path], SourceItem | None]:
    """Path and source folder → the motion that a file holds, with the framerate and licence that stand beside it.

    What is wrong with the annotation tables beside the files is added to `of_tables`.
    """
    candidates = [entry for entry in FORMATS.values() if options.format in ("auto", entry.name)]

    @cache
    def around(folder: Path, root: Path) -> tuple[str, tuple[AnnotationTable, ...]]:
        licence, above = around(folder.parent, root) if folder != root else ("", ())
        tables, broken = _tables(folder)
        of_tables.extend((*broken, *(problem for table in tables for problem in table.problems)))
        return annotations.find_licence(folder) or licence, (*above, *tables)

    def item_of(path: Path, root: Path) -> SourceItem | None:
        kind = next((entry for entry in candidates if _takes(entry, path)), None)
        if kind is None:
            return None
        licence, tables = around(path.parent, root)
        # What a table says about a whole file need not be true of a stretch.
        return replace(_annotate(_file_item(kind, path, root, licence), tables), captions=(), split="")

    return item_of


def _root(source: Path) -> Path:
    return (source if source.is_dir() else source.parent).resolve()


def _scan_source(source: Path, options: ReadOptions, given: AnnotationTable | None) -> ScanResult:
    root = _root(source)
    beside: list[AnnotationTable] = []
    found: list[ScanResult] = []
    licences: dict[Path, str] = {}
    unlisted: list[OSError] = []
    one = [(root, [root / source.name])] if source.is_file() else None
    for folder, files in one or walk(root, _is_claimed, unlisted.append):
        licences[folder] = annotations.find_licence(folder) or licences.get(folder.parent, "")
        if given is None:
            tables_here, broken = _tables(folder)
            beside += tables_here
            found.append(ScanResult((), broken))
        found.append(_scan_folder(folder, files, root, licences[folder], options))
        if source.is_file() and not found[-1].items and not found[-1].problems:
            found.append(_recognise(root / source.name, licences[folder], options))
    tables = beside if given is None else [given]
    items = [_annotate(item, tables) for result in found for item in result.items]
    problems = [problem for result in found for problem in result.problems]
    warnings = [warning for result in found for warning in result.warnings]
    problems += [problem for table in beside for problem in table.problems]
    problems += [_unlisted(error) for error in unlisted]
    if source.is_dir():  # of a single file, the other rows of its folder's table are not missing
        known = {item.path for item in items}
        rows = [(table, path, row) for table in beside for path, row in table.rows.items()]
        problems += [_no_motion(table, path, row) for table, path, row in rows if path not in known]
    captioned = [root] if given is not None and given.has_captions else []
    captioned += [table.path.parent for table in beside if table.has_captions]
    return ScanResult(tuple(items), tuple(problems), (*warnings, *_motions_without_caption(items, captioned)))


def _unlisted(error: OSError) -> FormatError:
    message = f"the folder cannot be listed ({error.strerror or error})"
    return FormatError(message, path=error.filename or "", reason="unreadable")


def _problems_of_given(tables: Sequence[AnnotationTable], known: set[Path]) -> list[FormatError]:
    # One table was read once for each source; a row is missing where no source has its motion.
    if not tables:
        return []
    found = {row.line for table in tables for path, row in table.rows.items() if path in known}
    rows = [(path, row) for path, row in tables[0].rows.items() if row.line not in found]
    return [*tables[0].problems, *(_no_motion(tables[0], path, row) for path, row in rows)]


def _no_motion(table: AnnotationTable, path: Path, row: Annotation) -> FormatError:
    message = f"describes {path.name}, but there is no such motion in the source"
    return FormatError(message, path=table.path, reason="caption-without-motion", line=row.line)


def _is_claimed(folder: Path) -> bool:
    return any(entry.claims is not None and entry.claims(folder) for entry in FORMATS.values())


def _scan_folder(folder: Path, files: Iterable[Path], root: Path, licence: str, options: ReadOptions) -> ScanResult:
    candidates = [entry for entry in FORMATS.values() if options.format in ("auto", entry.name)]
    for entry in candidates:
        if entry.claims is not None and entry.find is not None and entry.claims(folder):
            found = entry.find(folder, root)
            return replace(found, items=tuple(replace(item, licence=item.licence or licence) for item in found.items))
    kinds = ((path, next((entry for entry in candidates if _takes(entry, path)), None)) for path in files)
    return ScanResult(tuple(_file_item(kind, path, root, licence) for path, kind in kinds if kind is not None))


def _recognise(path: Path, licence: str, options: ReadOptions) -> ScanResult:
    # A single file whose name says nothing is known by how it begins.
    with path.open("rb") as file:
        head = file.read(4096).removeprefix(b"\xef\xbb\xbf")
    words = next((line.strip() for line in head.splitlines() if line.strip() and not line.startswith(b"#")), b"")
    for entry in FORMATS.values():
        if options.format in ("auto", entry.name) and entry.begins and words.upper().startswith(entry.begins):
            return ScanResult((_file_item(entry, path, path.parent, licence),))
    return ScanResult(())


def _file_item(kind: Format, path: Path, root: Path, licence: str) -> SourceItem:
    relative = path.relative_to(root)
    return SourceItem(
        format=kind.name,
        path=path,
        root=root,
        sequence_id=f"{root.name}/{relative.with_suffix('').as_posix()}",
        source=root.name,
        subset=relative.parts[0] if len(relative.parts) > 1 else "",
        licence=licence,
    )


def _takes(entry: Format, path: Path) -> bool:
    return path.suffix.lower() in entry.suffixes and (entry.accepts is None or entry.accepts(path))


def _tables(folder: Path) -> tuple[list[AnnotationTable], tuple[FormatError, ...]]:
    tables: list[AnnotationTable] = []
    problems: list[FormatError] = []
    for path in annotations.find_annotations(folder):
        try:
            tables.append(annotations.read_annotations(path))
        except FormatError as problem:
            problems.append(problem)
    return tables, tuple(problems)


def _annotate(item: SourceItem, tables: Sequence[AnnotationTable]) -> SourceItem:
    # A table nearer to the file was found later and has the last word.
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
        licence=row.licence or item.licence,
        source=row.source or item.source,
        # A folder's name is no subset of a source that the row names itself.
        subset=row.subset or ("" if row.source else item.subset),
    )


def _motions_without_caption(items: Iterable[SourceItem], folders: Sequence[Path]) -> list[FormatError]:
    message = "has no caption in a source that has captions; kept without one"
    return [
        FormatError(message, path=item.path, reason="no-caption")
        for item in items
        if not item.captions and any(item.path.is_relative_to(folder) for folder in folders)
    ]


def _nothing(source: Path, options: ReadOptions) -> FormatError:
    expected = options.format if options.format != "auto" else ", ".join(FORMATS)
    if source.is_file():
        return FormatError(f"of no known format, expected {expected}", path=source, reason="unknown-format")
    return FormatError(f"no motions in this folder, expected {expected}", path=source, reason="empty-folder")


def _unique(items: Iterable[SourceItem]) -> tuple[tuple[SourceItem, ...], list[FormatError]]:
    kept: dict[str, SourceItem] = {}
    problems: list[FormatError] = []
    for item in items:
        first = kept.setdefault(item.sequence_id, item)
        if first is not item:
            problems.append(
                FormatError(
                    f"its id {item.sequence_id!r} is already taken by {first.path.name}; rename the file or its folder",
                    path=item.path,
                    reason="duplicate-id",
                )
            )
    return tuple(kept.values()), problems
