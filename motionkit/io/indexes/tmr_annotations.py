"""Annotations as TMR ships them: JSON, sequence name → path into AMASS, duration, captions with their seconds.

KIT-ML in this form has 5,766 sequences, half of them mirrored ones (names with an M, paths that begin with M/). Source:
https://github.com/Mathux/AMASS-Annotation-Unifier (README), https://github.com/Mathux/TMR (datasets/annotations).
"""

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

MIRROR = "M"
# Durations in the file are rounded to a millisecond, or to about ten digits.
SAME_SECONDS = 2e-3


def recognise(first: Any) -> bool:
    """Whether a JSON index is of this kind, judged by its first value."""
    return isinstance(first, dict) and {"path", "annotations"} <= set(first)


def read_tmr_annotations(path: Path) -> Index:
    """Read all sequences; unusable ones become problems. Raises `FormatError` (`index`).

    A sequence spans all of its captions, or the whole file if they cover the stated duration.
    """
    return read_entries(index_name(path), path, read_json_index(path).items(), lambda row: _entry(*row, path))


def index_name(path: Path) -> str:
    """`kitml` for kitml.json, kitml-annotations.json and kitml/annotations.json."""
    name = path.stem.removesuffix("annotations").rstrip("-_.") or path.resolve().parent.name
    return name.casefold() or "annotations"


def _entry(name: str, value: Any, path: Path) -> Entry:
    name = sequence_name(name, path, "a sequence", None)
    if not isinstance(value, dict) or not isinstance(value.get("annotations"), list):
        raise FormatError(f"{name}: no path and annotations", path=path, reason="index-entry")
    parts = source_parts(value.get("path"), path, name, None)
    mirrored = parts[0] == MIRROR and len(parts) > 1
    said = [_caption(caption, path, name) for caption in value["annotations"]]
    start = min((caption.start_seconds for caption in said), default=0.0)
    end = max((caption.end_seconds or 0.0 for caption in said), default=None)
    duration = seconds_of(value["duration"], "duration", path, name) if "duration" in value else None
    if end is not None and duration is not None and end >= duration - SAME_SECONDS:
        end = None
    return Entry(
        name=name,
        parts=_with_suffix(parts[1:] if mirrored else parts),
        place=name,
        cut=TimeCut(start, end, duration),
        captions=tuple(_from_start(caption, start, end) for caption in said),
        mirrored=mirrored,
    )


def _caption(value: Any, path: Path, name: str) -> Caption:
    if not isinstance(value, dict) or not isinstance(value.get("text"), str):
        raise FormatError(f"{name}: an annotation without text", path=path, reason="index-entry")
    start, end = (seconds_of(value.get(which), which, path, name) for which in ("start", "end"))
    return Caption(value["text"], min(start, end), max(start, end))


def _from_start(caption: Caption, start: float, end: float | None) -> Caption:
    # Seconds of the file → seconds of the sequence; the end is None for a caption that reaches the end.
    stop = caption.end_seconds or 0.0
    to_end = end is None or stop >= end - SAME_SECONDS
    return Caption(caption.text, caption.start_seconds - start, None if to_end else stop - start)


def _with_suffix(parts: tuple[str, ...]) -> tuple[str, ...]:
    # Paths in these files have no suffix, but names may contain a point.
    return (*parts[:-1], f"{parts[-1]}.npz")
