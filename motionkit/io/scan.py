"""Finding the sequences of a source (`scan`), and reading one of them (`read`): so ingest scans once, and many read.

`scan` lists folders and reads the beginnings of files whose suffix is ambiguous. `read` reads a sequence's file,
corrects its framerate by rules, crops and mirrors it, and adds what annotation tables state.

A rule corrects framerates that files state wrongly. It has globs of files (`pathlib.PurePath.match`), the wrong
framerate that they state (`stated`; omitted: any), the right one, and its source. The user's rules come first, and the
first matching rule applies; an explicit framerate (--fps, or the column fps of an annotation table) overrides all
rules. The shipped ones are framerate_rules.toml.
"""

import os
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import cache, lru_cache
from importlib import resources
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from motionkit.core.errors import FormatError, UsageError, counted, shown
from motionkit.core.files import LONGEST_TOML, is_store, parse_toml, read_at_most
from motionkit.core.motion import Motion, captions_within, mirror
from motionkit.core.skeletons.mapping import with_layout_map
from motionkit.core.timegrid import TimeGrid, parse_fps
from motionkit.io.annotations import AnnotationTable, annotated, read_annotations, tables_in
from motionkit.io.body_frame import check_unit, log_lines, turned
from motionkit.io.cuts import crop
from motionkit.io.registry import (
    FileHead,
    Format,
    FramerateRule,
    Reader,
    ReadOptions,
    ScanResult,
    SourceItem,
    reader_of,
    readers,
    recognise,
    recognise_folder,
)
from motionkit.io.source_file import check_size, unreadable

if TYPE_CHECKING:
    from motionkit.io.bvh import BvhDocument

MAX_LICENCE_LETTERS = 120
# Folders above a single file whose tables may describe it.
LEVELS_ABOVE_A_FILE = 3
# Files that belong to motions, or describe them: they are not reported as ignored.
SIDE_FILES = ("licen[cs]e*", "*.asf", "shape.npz", "*_stagei.npz", "motions.json", "frame_cuts.csv")
# Files that are never loaded; docs/formats.md has the lines that convert them.
REFUSED_SUFFIXES = (".fbx", ".pt", ".pth", ".pkl", ".pickle")
COMPLETED, PLANTED = "completed", "planted"
DERIVED_FOLDER = re.compile(rf"({COMPLETED}|{PLANTED})-[\d.-]+fps")
# Reasons for refusing a file that lacks only a usable framerate.
NO_FRAMERATE = frozenset({"no-framerate", "framerate", "frame-time"})
RULE_KEYS = frozenset({"files", "stated", "fps", "reason", "source"})


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
        if not (source.is_file() or source.is_dir()):
            raise UsageError(f"there is no file or folder {source}")
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

    A folder that `is_whole` is not entered. Links to folders are followed; folders already visited, those that contain
    the source, and stores are skipped. What cannot be listed or looked at (`unreadable`) goes to `on_problem`.
    """
    visited = {root.resolve()}
    listed = os.walk(
        root, followlinks=True, onerror=lambda error: on_problem(unreadable(Path(str(error.filename)), error))
    )
    for name, folders, entries in listed:
        folder = Path(name)
        files: list[Path] = []
        for path in (folder / entry for entry in sorted(entries) if not entry.startswith(".")):
            try:
                if path.is_file():  # not a pipe, which would block
                    files.append(path)
                else:
                    path.stat()  # raises for a link that leads nowhere
            except OSError as error:
                on_problem(unreadable(path, error))
        below = [] if is_whole(folder) else sorted(folders, key=lambda entry: ((folder / entry).is_symlink(), entry))
        folders.clear()
        for entry in below:
            real = (folder / entry).resolve()
            is_inner = real not in visited and not root.is_relative_to(real)
            if is_inner and not entry.startswith((".", "__")) and not is_store(folder / entry):
                visited.add(real)
                folders.append(entry)
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
        tables, problems = list[AnnotationTable](), list[FormatError]()
        if next(folder.glob("*.csv"), None):
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
    data_set = cache(lambda folder: recognise_folder(folder, options.format))
    folders = walk(root, lambda folder: data_set(folder) is not None, problems.append)
    for folder, files in folders if is_folder else [(root, [root / source.name])]:
        licence, tables = side_files.of(folder)
        heads = [FileHead(path) for path in files]
        is_known = not is_folder and recognise(heads[0], options.format) is not None
        kind = None if is_known else data_set(folder)
        if kind is not None and kind.find is not None:
            found = kind.find(folder, root)
            of_source = (each for each in found.items if is_folder or each.path == files[0])
            items += (annotated(replace(each, licence=each.licence or licence), tables) for each in of_source)
            problems += (each for each in found.problems if is_folder or each.path == files[0])
            warnings += (each for each in found.warnings if is_folder or each.path == files[0])
            continue
        for head in heads:
            path = head.path
            kind = recognise(head, options.format)
            if kind is None and not is_folder and options.format != "auto":
                kind = reader_of(options.format)  # whatever the file is called
            # The source folder's own name is ignored: whoever names a folder of completed clips means them.
            named = path if folder != root else Path(path.name)
            if kind is None or (options.skip_derived and is_folder and is_derived(named)):
                others.append(path)
            else:
                of_file = _items_of_file(kind, head, root, licence)
                items += (annotated(each, tables) for each in of_file) if tables else of_file
    problems += side_files.problems
    if is_folder and items:  # of a single file, other rows are not expected
        problems += _without_motion(side_files.tables, {item.path for item in items})
    if not items and not problems:
        problems.append(_no_motion(source, others, options))
    warnings += (warning for table in side_files.tables for warning in table.warnings)
    known = {problem.path for problem in problems} | {table.path for table in side_files.tables}
    known |= set() if given is None else {given.path.parent.resolve() / given.path.name}
    ignored = tuple(
        path
        for path in others
        if is_folder and path not in known and not any(fnmatchcase(path.name.lower(), each) for each in SIDE_FILES)
    )
    return ScanResult(tuple(items), tuple(problems), tuple(warnings), ignored=ignored)


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
    for table in tables:
        for path, row in table.rows.items():
            if (table.path, row["line"]) in reported:
                continue
            reported.add((table.path, row["line"]))
            message = f"describes {path.name}, but there is no such motion in the source"
            yield FormatError(message, path=table.path, reason="caption-without-motion", line=row["line"])


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
    if len(files) != 1 or not files[0].is_file():
        return ", ".join(entry.name for entry in files)
    text = FileHead(files[0]).content.decode("utf-8", "replace").strip()
    return " ".join(text.partition("\n")[0].split())[:MAX_LICENCE_LETTERS]


def _no_motion(source: Path, others: Sequence[Path], options: ReadOptions) -> FormatError:
    expected = options.format if options.format != "auto" else ", ".join(readers())
    if any(path.suffix.lower() in REFUSED_SUFFIXES for path in (source, *others)):
        expected += "; docs/formats.md#fbx-and-pickles converts FBX files and pickles"
    if source.is_file():
        message = f"of no known format, expected {expected}"
        return FormatError(message, path=source, reason="unknown-format")
    first = f", the first: {others[0].relative_to(source.resolve())}" if others else ""
    message = f"no motions in this folder (it has {counted(len(others), 'file')}{first}), expected {expected}"
    return FormatError(message, path=source, reason="empty-folder")


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

    unlisted: list[FormatError] = []

    def files() -> Iterator[tuple[Path, Path]]:
        for source in sources:
            if not source.is_dir():
                raise UsageError(f"{source} is not a folder; an index names files below a folder")
            root = source.resolve()
            yield from (
                (path, root) for _, paths in walk(root, lambda folder: False, unlisted.append) for path in paths
            )

    found = scan_indexes(files(), options.index, item_of)
    problems, warnings = list(found.problems), [*unlisted, *found.warnings]
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


# Reading a sequence


def read(item: SourceItem, options: ReadOptions | None = None) -> Motion:
    """Read one sequence with its annotations; raises `FormatError`, `too-large` beyond a store's limit."""
    options = _with_fps(item, options)
    if item.cut is None and not item.mirrored:
        motion = _read_file(item, options)
        motion = _without_first(replace(motion, captions=item.captions or motion.captions), item, options)
    else:
        motion = _read_segment(item, options)
    return _annotated(motion, item, options)


def read_document(item: SourceItem, options: ReadOptions | None = None) -> "BvhDocument | None":
    """The document of a whole file with its annotations, None if its format has none.

    Its motion is that of `read`. Raises `FormatError`.
    """
    options, document_of = _with_fps(item, options), reader_of(item.format).document
    if document_of is None:
        return None
    documents: list[BvhDocument] = []

    def read_file(item: SourceItem, options: ReadOptions) -> Motion:
        documents.append(document_of(item.path, options))
        return documents[-1].motion

    motion = replace(_corrected(item, options, read_file), captions=item.captions)
    kept = _without_first(motion, item, options)
    document = documents[-1].frames(motion.num_frames - kept.num_frames, motion.num_frames)
    return replace(document, motion=_annotated(kept, item, options))


def _with_fps(item: SourceItem, options: ReadOptions | None) -> ReadOptions:
    options = options or ReadOptions()
    return replace(options, fps=item.fps) if options.fps is None else options


def _read_file(item: SourceItem, options: ReadOptions) -> Motion:
    kind = reader_of(item.format)
    assert kind.read is not None
    motion = _corrected(item, options, kind.read)
    if not options.up or kind.turns_up:
        return motion
    (line,) = log_lines(options.up, options.up)
    return turned(motion, options.up).logged(line)


def _without_first(motion: Motion, item: SourceItem, options: ReadOptions) -> Motion:
    """The motion without its first frames, its clock starting at 0; raises `FormatError` if no frame is left.

    Captions, whose seconds count from the file's first frame, move with it; those of the left-out frames are dropped.
    """
    num_frames = options.skip_frames if item.skip_frames is None else item.skip_frames
    if num_frames == 0:
        return motion
    if num_frames >= motion.num_frames:
        message = f"{motion.num_frames} frames, of which the first {num_frames} are to be left out"
        raise FormatError(message, path=item.path, reason="skip-frames")
    kept = motion.frames(num_frames, motion.num_frames)
    seconds = float(num_frames / motion.fps)
    captions = tuple(
        replace(
            caption,
            start_seconds=max(0.0, caption.start_seconds - seconds),
            end_seconds=None if caption.end_seconds is None else caption.end_seconds - seconds,
        )
        for caption in captions_within(motion.captions, kept.timegrid)
    )
    line = f"the first {num_frames} of {motion.num_frames} frames left out (skip_frames)"
    return replace(kept, timegrid=TimeGrid(motion.fps, kept.num_frames), captions=captions).logged(line)


def _read_segment(item: SourceItem, options: ReadOptions) -> Motion:
    whole = SourceItem(item.format, item.path, item.root, sequence_id="", key=item.key, fps=item.fps)
    try:
        status = item.path.stat()
    except OSError as error:
        raise unreadable(item.path, error) from None
    motion = _read_once(whole, options, (status.st_mtime_ns, status.st_size))
    stated_fps = item.stated_fps or motion.provenance.stated_fps  # which frames an index counted depends on it
    provenance = replace(motion.provenance, stated_fps=stated_fps)
    captions = item.captions or motion.captions
    motion = replace(motion, captions=captions, provenance=provenance, sequence_id=item.sequence_id)
    if item.cut is not None:
        motion = crop(motion, item.cut, item.path)
    if not item.mirrored:
        return motion
    try:
        return mirror(motion)
    except ValueError as error:
        raise FormatError(f"cannot be mirrored: {error}", path=item.path, reason="mirror") from None


@lru_cache(maxsize=1)
def _read_once(whole: SourceItem, options: ReadOptions, version: tuple[int, int]) -> Motion:
    # The segments of a file are consecutive, and reading it costs far more than cutting it. A file that has changed
    # since is read again.
    return _read_file(whole, options)


def _annotated(motion: Motion, item: SourceItem, options: ReadOptions) -> Motion:
    check_unit(motion.skeleton, motion.joint_positions[:1], options.unit_metres, item.path)
    check_size(motion.num_frames, motion.skeleton.num_joints, item.path)
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


# Rules of framerates


def read_rules(path: Path) -> tuple[FramerateRule, ...]:
    """The rules of a TOML file in its order; raises `UsageError` that names the file, the rule and the fault."""
    try:
        text = read_at_most(path, LONGEST_TOML).decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    return parse_rules(text, str(path))


@cache
def shipped_rules() -> tuple[FramerateRule, ...]:
    """The corrections that motionkit ships, each with its source."""
    text = resources.files(__package__).joinpath("framerate_rules.toml").read_text(encoding="utf-8")
    return parse_rules(text, "shipped")


def parse_rules(text: str, name: str) -> tuple[FramerateRule, ...]:
    """The rules in TOML text; `name` is for messages. Raises `UsageError`."""
    rules: list[FramerateRule] = []
    where = name
    try:
        for number, table in enumerate(parse_toml(text)["rule"], start=1):
            where = f"{Path(name).name}, rule {number}"
            if not {"files", "fps"} <= set(table) <= RULE_KEYS:
                raise ValueError(f"it has {shown(table)}")
            globs = (table["files"],) if isinstance(table["files"], str) else tuple(table["files"])
            if not globs or not all(isinstance(each, str) and each.strip("./") for each in globs):
                raise ValueError(f"files must be a glob in quotes, or a list of them, not {shown(globs)}")
            stated = parse_fps(table["stated"]) if "stated" in table else None
            rules.append(FramerateRule(globs, parse_fps(table["fps"]), stated, str(table.get("source", "")), where))
    except (ValueError, KeyError, TypeError) as error:
        expected = "expected tables [[rule]] with files, fps and, if you like, stated, reason, source (docs/formats.md)"
        raise UsageError(f"{where}: {error}; {expected}") from None
    return tuple(rules)


def _corrected(item: SourceItem, options: ReadOptions, read: Reader) -> Motion:
    # The whole file, its framerate corrected by a rule unless the user has given one.
    if options.fps is not None:
        return read(item, options)
    # Globs match the path from the source folder's name on.
    place = PurePosixPath(item.root.name, item.path.relative_to(item.root).as_posix())
    rules = [rule for rule in (*options.fps_rules, *shipped_rules()) if any(map(place.match, rule.files))]
    try:
        motion = read(item, options)
    except FormatError as problem:
        rule = next((rule for rule in rules if rule.stated is None), None)
        if rule is None or problem.reason not in NO_FRAMERATE:
            raise
        return read(item, replace(options, fps=rule.fps)).logged(f"framerate by rule ({rule.where})")
    rule = next((rule for rule in rules if rule.stated in (None, motion.fps)), None)
    if rule is None or rule.fps == motion.fps:
        return motion
    by = f"({rule.where}{f', {rule.source}' if rule.source else ''})"
    line = f"framerate set to {rule.fps} by rule {by}; the file says {motion.fps}"
    return replace(motion, timegrid=replace(motion.timegrid, fps=rule.fps)).logged(line)
