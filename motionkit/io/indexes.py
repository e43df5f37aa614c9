"""Indexes: files that list the segments of motion files that form a corpus, with names and captions.

Four kinds are read:

- HumanML3D's index.csv: source_path, start_frame, end_frame, new_name; 14,616 rows. `motionkit.io.cuts` explains how
  frames are counted. Rows of humanact12 have the end −1 and take the whole file. Source:
  https://github.com/EricGuo5513/HumanML3D (index.csv, raw_pose_processing.ipynb).
- TMR's annotations: JSON, sequence name → path into AMASS, duration, captions with their seconds. KIT-ML in this form
  has 5,766 sequences, half of them mirrored ones (names with an M, paths that begin with M/). Source:
  https://github.com/Mathux/AMASS-Annotation-Unifier (README), https://github.com/Mathux/TMR (datasets/annotations).
- BABEL's labels: train.json, val.json, test.json and their extra_ forms, sequence → file of AMASS, labels in seconds. A
  sequence has labels of the whole (`seq_ann`, extra: `seq_anns`) and of segments (`frame_ann`, extra: `frame_anns`);
  either may be null, and test.json has none. Each label has `raw_label` (the annotator's words), `proc_label`,
  `act_cat` (categories), and, for segments, `start_t` and `end_t`. Source: https://github.com/abhinanda-punnakkal/BABEL.
- BONES-SEED's metadata: seed_metadata_v004.csv, 142,220 rows, half of them of mirrored files (is_mirror), each with the
  paths of its motion as SOMA's uniform and proportional BVH and as the G1's CSV, of which the first that the sources
  have is read; and the labels beside it, seed_metadata_v002_temporal_labels.jsonl: lines of filename, events with
  start_time, end_time, description. Source: https://huggingface.co/datasets/bones-studio/seed,
  https://github.com/bones-studio/seed-viewer (backend/src/globals.py, soma/parse_data_example_minimal.py).

The files of an index are found by name alone, whatever the spelling, without opening them: in a folder of all of AMASS
only the files of the index are read.
"""

import csv
import re
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import resources
from json import JSONDecodeError
from pathlib import Path
from typing import Any

from motionkit.core.errors import FormatError, UsageError
from motionkit.core.files import parse_json
from motionkit.core.motion import Caption
from motionkit.io import source_file
from motionkit.io.cuts import Cut, StepCut, TimeCut
from motionkit.io.registry import IndexOptions, ScanResult, SourceItem
from motionkit.io.texts import SPLITS, read_splits, read_texts, split_files

Key = tuple[str, ...]
# The motion that a file holds, or None for a file of no known format.
ItemOf = Callable[[Path, Path], SourceItem | None]

# SMPL+H files are called NAME_poses, SMPL-X files NAME_stageii. HumanML3D and BABEL count in frames of the former.
ENDINGS = ("_poses", "_stageii")
MIRROR = "M"
SEED_PATHS = ("move_soma_uniform_path", "move_soma_proportional_path", "move_g1_path", "move_g1_mujoco_path")
SEED_TEXTS = (*(f"natural_desc_{number}" for number in "1234"), "short_description", "short_description_2")
SEED_LABELS = "*temporal_labels*.jsonl"
HUMANML3D_COLUMNS = ("source_path", "start_frame", "end_frame", "new_name")
HUMANACT12 = "humanact12"
WHOLE_FILE = -1
MAX_NAME, MAX_SECONDS = 120, 1e6
# TMR's durations are rounded to a millisecond, or to about ten digits.
SAME_SECONDS = 2e-3


@dataclass(frozen=True)
class Dataset:
    """A dataset of AMASS: its folder's name in the first release, and how HumanML3D read its files.

    `trim_frames` are dropped before frames are counted; `seen_fps` is the framerate that its code read where a file may
    state another, by the subject's folder, under "" for all others.
    """

    name: str
    trim_frames: int = 0
    seen_fps: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Entry:
    """A sequence of an index: the file, the segment of it, and its annotations.

    `parts` is the file's path as the index spells it, `others` are paths of the same motion in other formats. `cut`
    None takes the whole file, which holds the mirrored motion if the entry is `mirrored`; `line` is the entry's line in
    an index that has lines.
    """

    name: str
    parts: tuple[str, ...]
    cut: Cut | None = None
    captions: tuple[Caption, ...] = ()
    action: str = ""
    style: str = ""
    subject: str = ""
    split: str = ""
    mirrored: bool = False
    line: int | None = None
    others: tuple[tuple[str, ...], ...] = ()

    @property
    def key(self) -> Key:
        """The file's normalised path (`file_key`)."""
        return file_key(self.parts)

    @property
    def dataset(self) -> str:
        """Name of the file's dataset; the first folder's name if the dataset is unknown."""
        found = dataset_of(self.parts)
        return found[0].name if found else (self.parts[0] if len(self.parts) > 1 else "")


@dataclass(frozen=True)
class Index:
    """An index: its name, a prefix of its sequences' ids; its entries; and the rows that could not be used."""

    name: str
    path: Path
    entries: tuple[Entry, ...]
    problems: tuple[FormatError, ...] = ()


# The spelling of files


def dataset_of(parts: Sequence[str]) -> tuple[Dataset, int] | None:
    """The dataset named by a path's folders, and that folder's position; the last of several, since some are nested."""
    known = _known_datasets()
    for position in range(len(parts) - 2, -1, -1):
        found = known.get(_plain(parts[position]))
        if found is not None:
            return found, position
    return None


def file_key(parts: Sequence[str]) -> Key:
    """A file's path normalised across spellings: the dataset's name, the folders below it, the file.

    Case, runs of blanks and underscores, `_poses` and `_stageii`, and the file's suffix are ignored; without a known
    dataset the whole path is used.
    """
    found = dataset_of(parts)
    first = 0 if found is None else found[1] + 1
    head = () if found is None else (found[0].name,)
    return (*head, *(_spelling(part) for part in parts[first:-1]), _spelling(stem(parts[-1])))


def stem(name: str) -> str:
    """A file's name without its suffix and AMASS' endings."""
    plain = name.rpartition(".")[0] or name
    for ending in ENDINGS:
        plain = plain.removesuffix(ending)
    return plain


@cache
def _known_datasets() -> Mapping[str, Dataset]:
    table = tomllib.loads(resources.files(__package__).joinpath("amass_datasets.toml").read_text(encoding="utf-8"))
    known: dict[str, Dataset] = {}
    for entry in table["dataset"]:
        dataset = Dataset(entry["name"], entry.get("trim_frames", 0), entry.get("seen_fps", {}))
        known |= {_plain(name): dataset for name in (entry["name"], *entry.get("also", ()))}
    return known


@cache
def _plain(name: str) -> str:
    return re.sub(r"[\W_]", "", name.casefold())


def _spelling(part: str) -> str:
    return re.sub(r"[\s_]+", "_", part.strip()).casefold()


# Reading an index


def read_index(path: Path) -> Index:
    """Read an index of any kind: HumanML3D's index.csv, TMR's annotations, BABEL's labels, BONES-SEED's metadata.

    Bad entries become its `problems`. Raises `FormatError` (`index`, `encoding`, `empty`, `unreadable`) for any other
    file.
    """
    data = source_file.read_bytes(path)
    text = source_file.decode(data, path)
    header = text.lstrip().partition("\n")[0]
    if "source_path" in header and "new_name" in header:
        return _read_csv(text, path, "humanml3d", HUMANML3D_COLUMNS, _humanml3d)
    if "filename" in header and SEED_PATHS[0] in header:
        events = _seed_events(path.parent)
        return _read_csv(text, path, "seed", ("filename",), lambda name, row: _seed(name, row, events.get(name, ())))
    if text.lstrip().startswith("{"):
        try:
            entries = parse_json(text)
        except ValueError as error:
            line = error.lineno if isinstance(error, JSONDecodeError) else None
            raise FormatError(f"not JSON ({error})", path=path, reason="index", line=line) from None
        first = next(iter(entries.values()), None)
        if isinstance(first, dict) and {"path", "annotations"} <= first.keys():
            # `kitml` for kitml.json, kitml-annotations.json and kitml/annotations.json.
            name = path.stem.removesuffix("annotations").rstrip("-_.") or path.resolve().parent.name
            rows = ((each, None, entry) for each, entry in entries.items())
            return _index(name.casefold() or "annotations", path, rows, _tmr)
        if isinstance(first, dict) and "feat_p" in first:
            named = re.search(r"train|val|test", path.stem)
            split = named[0] if named else ""
            rows = ((each, None, (entry, split)) for each, entry in entries.items())
            return _index("babel", path, rows, _babel)
    message = f"looks like {source_file.describe_content(data)}, expected an index: HumanML3D's index.csv"
    message += ", BONES-SEED's metadata (CSV), TMR's annotations (JSON) or BABEL's labels (JSON)"
    raise FormatError(message, path=path, reason="index")


def _index(
    name: str, path: Path, rows: Iterable[tuple[str, int | None, Any]], entry_of: Callable[[str, Any], Entry]
) -> Index:
    """The index built from rows, each with its name and line; bad ones and repeated names become problems."""
    kept: dict[str, Entry] = {}
    problems: list[FormatError] = []
    for sequence_name, line, row in rows:
        try:
            # A part of the sequence's id and its text file's name.
            is_plain = sequence_name.isprintable() and not {"/", "\\"} & set(sequence_name)
            if not is_plain or sequence_name in ("", ".", "..") or len(sequence_name) > MAX_NAME:
                raise ValueError(f"the name {sequence_name[:80]!r}; expected a plain file name such as 000000")
            entry = replace(entry_of(sequence_name, row), line=line)
        except ValueError as bad:
            prefix = "" if line is not None else f"{sequence_name[:MAX_NAME]!r}: "
            problems.append(FormatError(f"{prefix}{bad}", path=path, reason="index-entry", line=line))
            continue
        first = kept.setdefault(entry.name, entry)
        if first is not entry:
            message = f"{entry.name!r} is named twice, first in line {first.line}"
            problems.append(FormatError(message, path=path, reason="duplicate-id", line=line))
    return Index(name, path, tuple(kept.values()), tuple(problems))


def _source_parts(value: object) -> tuple[str, ...]:
    """The folders and the file of a path in an index, without `.` and HumanML3D's leading `pose_data`."""
    parts = tuple(part for part in value.split("/") if part not in ("", ".")) if isinstance(value, str) else ()
    if not parts:
        raise ValueError(f"the path is {str(value)[:80]!r}, expected folders and a file, separated by /")
    return parts[1:] if parts[0] == "pose_data" and len(parts) > 1 else parts


def _seconds(value: object, what: str) -> float:
    number = float(value) if isinstance(value, int | float) and not isinstance(value, bool) else -1.0
    if not 0.0 <= number < MAX_SECONDS:
        raise ValueError(f"{what} is {str(value)[:40]}, expected seconds from 0 on")
    return number


def _captions(annotations: Iterable[Any], text: str, start: str, end: str) -> list[Caption]:
    """The sentences of objects with these keys, with their seconds; swapped ends are reordered."""
    captions = []
    for each in annotations:
        if not isinstance(each, dict) or not isinstance(each.get(text), str):
            raise ValueError(f"an annotation without {text}")
        first, last = sorted(_seconds(each.get(which), which) for which in (start, end))
        captions.append(Caption(each[text], first, last))
    return captions


def _read_csv(
    text: str, path: Path, name: str, expected: tuple[str, ...], entry_of: Callable[[str, Any], Entry]
) -> Index:
    """The index of a CSV table, whose last expected column names the sequences."""
    reader = csv.DictReader(text.splitlines(keepends=True), strict=True)

    def rows() -> Iterator[tuple[str, int, Mapping[str, str | None]]]:
        for row in reader:
            yield (row[expected[-1]] or "").strip().removesuffix(".npy"), reader.line_num, row

    try:
        columns = [column.strip() for column in reader.fieldnames or ()]
        absent = ", ".join(column for column in expected if column not in columns)
        if absent:
            message = f"no column {absent}; expected {','.join(expected)}, separated by commas"
            raise FormatError(message, path=path, reason="index", line=1)
        reader.fieldnames = columns
        return _index(name, path, rows(), entry_of)
    except csv.Error as error:
        raise FormatError(f"not a CSV table ({error})", path=path, reason="index", line=reader.line_num) from None


def _humanml3d(name: str, row: Mapping[str, str | None]) -> Entry:
    if None in row:
        raise ValueError("more cells than columns; a path with a comma needs quotes")
    parts = _source_parts(row["source_path"])
    start, end = (_frame(row, column) for column in ("start_frame", "end_frame"))
    found = dataset_of(parts)
    dataset = found[0] if found else Dataset("")
    whole = dataset.name == HUMANACT12 and (start, end) == (0, WHOLE_FILE)
    if not whole and not 0 <= start < end:
        message = f"frames [{start}, {end}); expected 0 <= start_frame < end_frame (0 and -1 for {HUMANACT12})"
        raise ValueError(message)
    seen_fps = next((dataset.seen_fps[part] for part in (*parts, "") if part in dataset.seen_fps), None)
    return Entry(name, parts, StepCut(start, None if whole else end, dataset.trim_frames, seen_fps))


def _frame(row: Mapping[str, str | None], column: str) -> int:
    cell = (row[column] or "").strip()
    # Pandas writes integers as floats if another row of the column is empty.
    if re.fullmatch(r"-?\d{1,7}(\.0)?", cell, re.ASCII):
        return int(float(cell))
    raise ValueError(f"{column} is {cell[:40]!r}, expected a whole number of frames")


def _seed_events(folder: Path) -> dict[str, list[Any]]:
    """The events of the label file in a folder, by the motion's name; empty without such a file."""
    path = next(iter(sorted(folder.glob(SEED_LABELS), reverse=True)), None)
    if path is None:
        return {}
    events: dict[str, list[Any]] = {}
    for line, text in enumerate(source_file.decode(source_file.read_bytes(path), path).split("\n"), start=1):
        if not text.strip():
            continue
        try:
            labels = parse_json(text)
            events[labels["filename"]] = list(labels["events"])
        except (ValueError, TypeError, KeyError):
            message = "expected JSON with filename and events on each line"
            raise FormatError(message, path=path, reason="index", line=line) from None
    return events


def _seed(name: str, row: Mapping[str, str | None], events: Iterable[Any]) -> Entry:
    """Captions are the natural and short descriptions of the whole motion, then the events with their seconds."""
    cells = {column: (cell or "").strip() for column, cell in row.items() if column and not isinstance(cell, list)}
    paths = [_source_parts(cells[column]) for column in SEED_PATHS if cells.get(column)]
    captions = [Caption(text) for kind in SEED_TEXTS if (text := cells.get(f"content_{kind}"))]
    captions += _captions(events, "description", "start_time", "end_time")
    return Entry(
        name=name,
        parts=paths[0] if paths else _source_parts(None),
        captions=tuple(dict.fromkeys(captions)),
        action=cells.get("content_type_of_movement", ""),
        style=cells.get("content_uniform_style", ""),
        subject=cells.get("actor_uid", ""),
        mirrored=cells.get("is_mirror", "").lower() in ("true", "1", "1.0"),
        others=tuple(paths[1:]),
    )


def _tmr(name: str, value: Any) -> Entry:
    """A sequence spans all of its captions, or the whole file if they cover the stated duration."""
    if not isinstance(value, dict) or not isinstance(value.get("annotations"), list):
        raise ValueError("no path and annotations")
    parts = _source_parts(value.get("path"))
    mirrored = parts[0] == MIRROR and len(parts) > 1
    parts = parts[1:] if mirrored else parts
    captions = _captions(value["annotations"], "text", "start", "end")
    start = min((caption.start_seconds for caption in captions), default=0.0)
    end = max((caption.end_seconds or 0.0 for caption in captions), default=None)
    duration = _seconds(value["duration"], "duration") if "duration" in value else None
    if end is not None and duration is not None and end >= duration - SAME_SECONDS:
        end = None
    return Entry(
        name=name,
        parts=(*parts[:-1], f"{parts[-1]}.npz"),  # paths in these files have no suffix, but names may contain a point
        cut=TimeCut(start, end, duration),
        captions=tuple(_from_start(caption, start, end) for caption in captions),
        mirrored=mirrored,
    )


def _from_start(caption: Caption, start: float, end: float | None) -> Caption:
    # Seconds of the file → seconds of the sequence; the end is None for a caption that reaches the end.
    stop = caption.end_seconds or 0.0
    to_end = end is None or stop >= end - SAME_SECONDS
    return Caption(caption.text, caption.start_seconds - start, None if to_end else stop - start)


def _babel(name: str, row: tuple[Any, str]) -> Entry:
    """Captions are the raw labels; the action is the category of the whole sequence if there is exactly one."""
    value, split = row
    if not isinstance(value, dict):
        raise ValueError("no feat_p and labels")
    of_whole = list(_labels(value, "seq_ann"))
    captions = [Caption(text) for label in of_whole if (text := _text(label))]
    for label in _labels(value, "frame_ann"):
        start, end = sorted(_seconds(label.get(which), which) for which in ("start_t", "end_t"))
        if _text(label):
            captions.append(Caption(_text(label), start, end))
    listed = [label["act_cat"] for label in of_whole if isinstance(label.get("act_cat"), list)]
    categories = {each for several in listed for each in several if isinstance(each, str)}
    return Entry(
        name=name,
        parts=_source_parts(value.get("feat_p")),
        cut=TimeCut(file_seconds=_seconds(value["dur"], "dur") if "dur" in value else None),
        captions=tuple(dict.fromkeys(captions)),
        action=next(iter(categories)) if len(categories) == 1 else "",
        split=split,
    )


def _labels(value: dict[str, Any], which: str) -> Iterator[dict[str, Any]]:
    several = value.get(f"{which}s")
    for annotation in several if isinstance(several, list) else [value.get(which)]:
        labels = annotation.get("labels") if isinstance(annotation, dict) else annotation
        if labels is None:
            continue
        if not isinstance(labels, list) or not all(isinstance(label, dict) for label in labels):
            raise ValueError(f"{which} without labels")
        yield from labels


def _text(label: dict[str, Any]) -> str:
    text = label.get("raw_label") or label.get("proc_label")
    return text.strip() if isinstance(text, str) else ""


# Finding the files of an index


def scan_indexes(places: Iterable[tuple[Path, Path]], options: IndexOptions, item_of: ItemOf) -> ScanResult:
    """The sequences of all indexes whose files are among `places`; the others are problems (`missing-file`).

    A place is a file and its source. Sequences of one file are consecutive, in the order in which the indexes first
    name the file. Raises `UsageError` for options that exclude each other, `FormatError` for an unreadable index.
    """
    whole = [read_index(path) for path in options.paths]
    indexes = [_chosen(index, options) for index in whole]
    warnings: list[FormatError] = []
    entries = (entry for index in indexes for entry in index.entries)
    files = _by_key(places, {file_key(parts) for entry in entries for parts in (entry.parts, *entry.others)})
    items_by_file: dict[Path, list[SourceItem]] = {}
    problems: list[FormatError] = []
    missing: Counter[str] = Counter()
    for index, unfiltered in zip(indexes, whole, strict=True):
        splits, of_splits = _splits(unfiltered, options)
        warnings += of_splits
        problems += index.problems
        found: dict[Key, SourceItem | None] = {}
        for entry in index.entries:
            present = (parts for parts in (entry.parts, *entry.others) if file_key(parts) in files)
            entry = replace(entry, parts=next(present, entry.parts))
            if entry.key not in found:
                of_key = (item_of(path, root) for path, root in files.get(entry.key, ()))
                found[entry.key] = next((item for item in of_key if item is not None), None)
            file = found[entry.key]
            if file is None:
                message = f"{entry.name}: there is no {'/'.join(entry.parts)} in the sources, in any known spelling"
                problems.append(FormatError(message, path=index.path, reason="missing-file", line=entry.line))
                missing[entry.dataset] += 1
                continue
            try:
                item = _item(index, entry, file, splits, options.texts)
            except FormatError as problem:
                problems.append(problem)
                continue
            items_by_file.setdefault(item.path, []).append(item)
    items = tuple(item for of_file in items_by_file.values() for item in of_file)
    return ScanResult(items, tuple(problems), tuple(warnings), missing)


def _chosen(index: Index, options: IndexOptions) -> Index:
    """The index after applying the options: with or without mirrored sequences, and in which frames."""
    in_published_frames = all(isinstance(entry.cut, StepCut) for entry in index.entries)
    if options.published and not in_published_frames:
        raise UsageError(f"only HumanML3D's index.csv has frames at 20 fps to reproduce, {index.path} has none")
    entries = list(index.entries)
    if not options.mirrored:
        entries = [entry for entry in entries if not entry.mirrored]
    elif in_published_frames:  # each sequence has a mirrored copy without a row
        copies = [replace(entry, name=MIRROR + entry.name, mirrored=True) for entry in entries]
        entries = [each for pair in zip(entries, copies, strict=True) for each in pair]
    elif not any(entry.mirrored for entry in entries):
        raise UsageError(f"{index.path} has no mirrored sequences, and captions that would not fit their mirror images")
    if options.published:
        cuts = [(entry, entry.cut) for entry in entries if isinstance(entry.cut, StepCut)]
        entries = [replace(entry, cut=replace(cut, published=True)) for entry, cut in cuts]
    name = f"{index.name}-20fps" if options.published else index.name
    return replace(index, name=name, entries=tuple(entries))


def _by_key(places: Iterable[tuple[Path, Path]], keys: set[Key]) -> dict[Key, list[tuple[Path, Path]]]:
    """The places whose files have one of the keys (`file_key`), by key, best first."""
    found: dict[Key, list[tuple[Path, Path]]] = {}
    for path, root in places:
        parts = path.relative_to(root).parts
        # The source may itself be a dataset's folder.
        key = next((key for key in (file_key(parts), file_key((root.name, *parts))) if key in keys), None)
        if key is not None:
            found.setdefault(key, []).append((path, root))
    for of_key in found.values():
        of_key.sort(key=lambda place: [place[0].stem.endswith(ending) for ending in ENDINGS], reverse=True)
    return found


def _item(index: Index, entry: Entry, file: SourceItem, splits: Mapping[str, str], texts: Path | None) -> SourceItem:
    path = texts / f"{entry.name}.txt" if texts else None
    return replace(
        file,
        sequence_id=f"{index.name}/{entry.name}",
        captions=read_texts(path) if path is not None and path.is_file() else entry.captions,
        action=entry.action or file.action,
        style=entry.style or file.style,
        subject=entry.subject or file.subject,
        split=splits.get(entry.name, entry.split),
        source=index.name,
        subset=entry.dataset,
        cut=entry.cut,
        mirrored=entry.mirrored and entry.cut is not None,
    )


def _splits(index: Index, options: IndexOptions) -> tuple[Mapping[str, str], list[FormatError]]:
    """The splits of sequences by name, from files beside the index or above the texts if no folder is given."""
    if options.texts is not None and not options.texts.is_dir():
        raise UsageError(f"{options.texts} is not a folder of texts such as 000000.txt")
    folder = options.splits
    if folder is None:
        beside = [index.path.parent, *([options.texts.resolve().parent] if options.texts else [])]
        folder = next((each for each in beside if "train" in split_files(each)), None)
    elif not split_files(folder):
        raise UsageError(f"{folder} has none of {', '.join(f'{split}.txt' for split in SPLITS)}, nor Kimodo's splits")
    if folder is None:
        return {}, []
    names = dict.fromkeys(entry.name for entry in index.entries)
    copies = dict.fromkeys(MIRROR + name for name in names)  # half of HumanML3D's split has no rows of its own
    return read_splits(folder, names | copies, index.path.name)
