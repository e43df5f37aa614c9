"""Finding the files of an index's entries in a folder of motions, by name alone, whatever the spelling.

Only names are compared, files are not opened: in a folder of all of AMASS only the files of the index are read.
"""

import json
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from motionkit.core.errors import FormatError, UsageError
from motionkit.core.motion import Caption
from motionkit.io import texts
from motionkit.io.indexes import babel, humanml3d_index, tmr_annotations
from motionkit.io.indexes.entries import Entry, Index, Key, dataset_of, file_key
from motionkit.io.scan.cuts import PublishedCut, StepCut
from motionkit.io.scan.folders import walk
from motionkit.io.scan.items import IndexOptions, ScanResult, SourceItem
from motionkit.io.source import source_file
from motionkit.io.texts import SPLITS, read_splits

MIRROR = "M"

# The motion that a file holds, or None for a file of no known format.
ItemOf = Callable[[Path, Path], SourceItem | None]


@dataclass(frozen=True)
class Sidecars:
    """Annotations of an index's sequences in other files: a split for some names, and a folder of captions."""

    splits: Mapping[str, str]
    texts: Path | None
    warnings: tuple[FormatError, ...] = ()

    def captions(self, name: str) -> tuple[Caption, ...] | None:
        """Captions of a sequence, None if it has none; raises `FormatError` for an invalid file."""
        path = self.texts / f"{name}.txt" if self.texts else None
        return texts.read_texts(path) if path is not None and path.is_file() else None


def scan_indexes(sources: Sequence[Path], options: IndexOptions, item_of: ItemOf) -> ScanResult:
    """The sequences of all indexes whose files are below the sources; the others are problems (`missing-file`).

    Sequences of one file are consecutive, in the order in which the indexes first name the file. Raises `UsageError`
    for sources that are not folders and options that exclude each other, `FormatError` for an unreadable index.
    """
    indexes = [_chosen(read_index(path), options) for path in options.paths]
    lost: list[FormatError] = []
    files = _find_files(sources, {entry.key for index in indexes for entry in index.entries}, lost.append)
    found = [_scan_index(index, sources, files, options, item_of) for index in indexes]
    missing: Counter[str] = Counter()
    refused: Counter[str] = Counter()
    for result in found:
        missing.update(result.missing)
        refused.update(result.refused)
    return ScanResult(
        items=tuple(_one_file_at_a_time(item for result in found for item in result.items)),
        problems=tuple(problem for result in found for problem in result.problems),
        warnings=(*lost, *(warning for result in found for warning in result.warnings)),
        missing=missing,
        refused=refused,
    )


def _chosen(index: Index, options: IndexOptions) -> Index:
    """The index after applying the options: with or without mirrored sequences, and in which frames."""
    if options.published and not index.in_published_frames:
        raise UsageError(f"only HumanML3D's index.csv has frames at 20 fps to reproduce, {index.path} has none")
    entries = list(index.entries)
    if not options.mirrored:
        entries = [entry for entry in entries if not entry.mirrored]
    elif index.in_published_frames:
        copies = [replace(entry, name=MIRROR + entry.name, mirrored=True) for entry in entries]
        entries = [each for pair in zip(entries, copies, strict=True) for each in pair]
    elif not any(entry.mirrored for entry in entries):
        raise UsageError(f"{index.path} has no mirrored sequences, and captions that would not fit their mirror images")
    if options.published:
        entries = [replace(entry, cut=PublishedCut(entry.cut)) for entry in entries if isinstance(entry.cut, StepCut)]
    name = f"{index.name}-20fps" if options.published else index.name
    return replace(index, name=name, entries=tuple(entries))


def _find_files(
    sources: Sequence[Path], wanted: set[Key], on_lost: Callable[[FormatError], None]
) -> dict[Key, list[tuple[Path, Path]]]:
    """Files below the sources by their `file_key`, best first, each with its source."""
    found: dict[Key, list[tuple[Path, Path]]] = {}
    for source in sources:
        if not source.is_dir():
            raise UsageError(f"{source} is not a folder; an index names files below a folder")
        root = source.resolve()
        for path in (path for _, files in walk(root, lambda folder: False, on_lost) for path in files):
            # The source may itself be a dataset's folder.
            parts = path.relative_to(root).parts
            named = (root.name, *parts)
            key = file_key(named if dataset_of(named) else parts)
            if key in wanted:
                found.setdefault(key, []).append((path, root))
    for paths in found.values():
        paths.sort(key=_preference)
    return found


def _preference(place: tuple[Path, Path]) -> int:
    # HumanML3D and BABEL count in the frames of the SMPL+H release; its files are called NAME_poses.
    stem = place[0].stem
    return 0 if stem.endswith("_poses") else 1 if stem.endswith("_stageii") else 2


def _scan_index(
    index: Index,
    sources: Sequence[Path],
    files: Mapping[Key, list[tuple[Path, Path]]],
    options: IndexOptions,
    item_of: ItemOf,
) -> ScanResult:
    sidecars = _sidecars(index, options)
    items: list[SourceItem] = []
    problems = list(index.problems)
    missing: Counter[str] = Counter()
    refused: Counter[str] = Counter()
    found: dict[Key, SourceItem | None] = {}
    for entry in index.entries:
        key = entry.key
        if key not in found:
            places = (item_of(path, root) for path, root in files.get(key, ()))
            found[key] = next((item for item in places if item is not None), None)
        file = found[key]
        if file is None:
            missing[entry.dataset] += 1
            problems.append(_missing(index, entry, sources))
            continue
        try:
            items.append(_item(index, entry, file, sidecars))
        except FormatError as problem:
            refused[entry.dataset] += 1
            problems.append(problem)
    warnings = _warnings(index, items, sidecars)
    return ScanResult(tuple(items), tuple(problems), warnings, missing, refused)


def _item(index: Index, entry: Entry, file: SourceItem, sidecars: Sidecars) -> SourceItem:
    captions = sidecars.captions(entry.name)
    return replace(
        file,
        sequence_id=f"{index.name}/{entry.name}",
        captions=entry.captions if captions is None else captions,
        action=entry.action or file.action,
        split=sidecars.splits.get(entry.name, entry.split),
        source=index.name,
        subset=entry.dataset,
        cut=entry.cut,
        mirrored=entry.mirrored,
    )


def _missing(index: Index, entry: Entry, sources: Sequence[Path]) -> FormatError:
    spelled = "/".join(entry.parts)
    return FormatError(
        f"{entry.name}: there is no {spelled} below {', '.join(map(str, sources))}, in no spelling that is known",
        path=index.path,
        reason="missing-file",
        line=entry.line,
    )


def _sidecars(index: Index, options: IndexOptions) -> Sidecars:
    if options.texts is not None and not options.texts.is_dir():
        raise UsageError(f"{options.texts} is not a folder of texts such as 000000.txt")
    folder = options.splits
    if folder is None:
        beside = [index.path.parent, *([options.texts.resolve().parent] if options.texts else [])]
        folder = next((each for each in beside if (each / "train.txt").is_file()), None)
    elif not any((folder / f"{split}.txt").is_file() for split in SPLITS):
        raise UsageError(f"{folder} has none of {', '.join(f'{split}.txt' for split in SPLITS)}")
    if folder is None:
        return Sidecars({}, options.texts)
    names = dict.fromkeys(entry.name for entry in index.entries)
    # Half of HumanML3D's split is mirrored; these are missing only if mirrored sequences were requested.
    copies = {} if options.mirrored else dict.fromkeys(MIRROR + name for name in names)
    splits, warnings = read_splits(folder, names | copies, index.path.name)
    return Sidecars(splits, options.texts, tuple(warnings))


def _warnings(index: Index, items: Iterable[SourceItem], sidecars: Sidecars) -> tuple[FormatError, ...]:
    warnings = list(sidecars.warnings)
    if sidecars.texts is not None or any(entry.captions for entry in index.entries):
        warnings += [
            FormatError(f"{item.sequence_id} has no caption; kept without one", path=item.path, reason="no-caption")
            for item in items
            if not item.captions
        ]
    return tuple(warnings)


def _one_file_at_a_time(items: Iterable[SourceItem]) -> Iterator[SourceItem]:
    of_file: dict[Path, list[SourceItem]] = {}
    for item in items:
        of_file.setdefault(item.path, []).append(item)
    for group in of_file.values():
        yield from group


# How much of a JSON index is read to get its first value, whose captions may be long.
HEAD_BYTES = 1 << 16

JSON_KINDS: tuple[tuple[Callable[[Any], bool], Callable[[Path], Index]], ...] = (
    (tmr_annotations.recognise, tmr_annotations.read_tmr_annotations),
    (babel.recognise, babel.read_babel),
)


def read_index(path: Path) -> Index:
    """Read an index of any kind: HumanML3D's index.csv, TMR's annotations, BABEL's labels.

    Bad entries become its `problems`. Raises `FormatError` (`index`, `encoding`, `empty`, `unreadable`) for any other
    file.
    """
    head = source_file.read_bytes(path)[:HEAD_BYTES].decode("utf-8-sig", errors="replace")
    if humanml3d_index.recognise(head):
        return humanml3d_index.read_humanml3d_index(path)
    first = _first_value(head)
    for recognise, read in JSON_KINDS:
        if recognise(first):
            return read(path)
    raise FormatError(
        f"looks like {source_file.describe_content(head.encode())}, expected an index: HumanML3D's index.csv (columns "
        f"{', '.join(humanml3d_index.COLUMNS)}), TMR's annotations (path, annotations) or BABEL's labels (feat_p)",
        path=path,
        reason="index",
    )


def _first_value(head: str) -> Any:
    # The first value of a JSON object, parsed from the beginning of the file; None if there is none.
    found = re.match(r'\s*\{\s*"(?:[^"\\]|\\.)*"\s*:\s*', head)
    if found is None:
        return None
    try:
        return json.JSONDecoder().raw_decode(head, found.end())[0]
    except (ValueError, RecursionError):
        return None
