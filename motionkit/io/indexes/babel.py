"""BABEL's labels: train.json, val.json, test.json and their extra_ forms, sequence → file of AMASS, labels in seconds.

A sequence has labels of the whole (`seq_ann`, extra: `seq_anns`) and of segments (`frame_ann`, extra: `frame_anns`);
either may be null, and test.json has none. Each label has `raw_label` (the annotator's words), `proc_label`, `act_cat`
(categories), and, for segments, `start_t` and `end_t`. Source: https://github.com/abhinanda-punnakkal/BABEL.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from motionkit.core.errors import FormatError
from motionkit.core.motion import Caption
from motionkit.io.indexes.entries import (
    Entry,
    Index,
    read_entries,
    read_json_index,
    seconds_of,
    sequence_name,
    source_parts,
)
from motionkit.io.scan.cuts import TimeCut

NAME = "babel"


def recognise(first: Any) -> bool:
    """Whether a JSON index is of this kind, judged by its first value."""
    return isinstance(first, dict) and "feat_p" in first


def read_babel(path: Path) -> Index:
    """Read all sequences, with the split from the file's name; unusable ones become problems.

    Captions are the raw labels. The action is the category of the whole sequence if there is exactly one.
    Raises `FormatError` (`index`).
    """
    named = re.search(r"train|val|test", path.stem)
    split = named[0] if named else ""
    return read_entries(NAME, path, read_json_index(path).items(), lambda row: _entry(*row, split, path))


def _entry(name: str, value: Any, split: str, path: Path) -> Entry:
    name = sequence_name(name, path, "a sequence", None)
    if not isinstance(value, dict):
        raise FormatError(f"{name}: no feat_p and labels", path=path, reason="index-entry")
    of_whole = list(_labels(value, "seq_ann", path, name))
    captions = [Caption(text) for label in of_whole if (text := _text(label))]
    for label in _labels(value, "frame_ann", path, name):
        start, end = (seconds_of(label.get(which), which, path, name) for which in ("start_t", "end_t"))
        if _text(label):
            captions.append(Caption(_text(label), min(start, end), max(start, end)))
    categories = {category for label in of_whole for category in _categories(label)}
    duration = seconds_of(value["dur"], "dur", path, name) if "dur" in value else None
    return Entry(
        name=name,
        parts=source_parts(value.get("feat_p"), path, name, None),
        place=name,
        cut=TimeCut(file_seconds=duration),
        captions=tuple(dict.fromkeys(captions)),
        action=next(iter(categories)) if len(categories) == 1 else "",
        split=split,
    )


def _labels(value: dict[str, Any], which: str, path: Path, name: str) -> Iterator[dict[str, Any]]:
    several = value.get(f"{which}s")
    annotations = several if isinstance(several, list) else [value.get(which)]
    for annotation in annotations:
        labels = annotation.get("labels") if isinstance(annotation, dict) else annotation
        if labels is None:
            continue
        if not isinstance(labels, list) or not all(isinstance(label, dict) for label in labels):
            raise FormatError(f"{name}: {which} without labels", path=path, reason="index-entry")
        yield from labels


def _text(label: dict[str, Any]) -> str:
    text = label.get("raw_label") or label.get("proc_label")
    return text.strip() if isinstance(text, str) else ""


def _categories(label: dict[str, Any]) -> list[str]:
    categories = label.get("act_cat")
    return [each for each in categories if isinstance(each, str)] if isinstance(categories, list) else []
