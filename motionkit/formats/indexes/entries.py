"""What an index says: entries, each a named stretch of a file; and the checks that every kind of index shares."""

import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from motionkit.errors import FormatError
from motionkit.formats import sourcefile
from motionkit.formats.cuts import Cut
from motionkit.formats.indexes.datasets import Key, dataset_of, file_key
from motionkit.motion import Caption
from motionkit.plain_text import parse_json

MAX_NAME = 120


@dataclass(frozen=True)
class Entry:
    """One sequence that an index names: which stretch of which file it is, and what is said about it.

    `parts` is the file's path as the index spells it. `cut` None takes the whole file; `place` says where in the index
    the entry stands, and `line` is its line where there are lines.
    """

    name: str
    parts: tuple[str, ...]
    place: str
    line: int | None = None
    cut: Cut | None = None
    captions: tuple[Caption, ...] = ()
    action: str = ""
    split: str = ""
    mirrored: bool = False

    @property
    def key(self) -> Key:
        """What all spellings of the file's path share."""
        return file_key(self.parts)

    @property
    def dataset(self) -> str:
        """Name of the dataset that the file is of; the first folder's where it is of none that is known."""
        found = dataset_of(self.parts)
        return found[0].name if found else (self.parts[0] if len(self.parts) > 1 else "")


@dataclass(frozen=True)
class Index:
    """One index: its name, which its sequences' ids begin with, its entries, and the rows that could not be used.

    `in_published_frames` says that its stretches are `StepCut`s, and that each has a mirrored copy without a row.
    """

    name: str
    path: Path
    entries: tuple[Entry, ...]
    problems: tuple[FormatError, ...] = field(default=())
    in_published_frames: bool = False


def source_parts(value: object, path: Path, place: str, line: int | None) -> tuple[str, ...]:
    """The parts of a path inside an index; raises `FormatError` (`path`) for one that could leave the source's folder.

    `.` and HumanML3D's leading `pose_data` are dropped.
    """
    text = value if isinstance(value, str) else ""
    parts = tuple(part for part in text.split("/") if part not in ("", "."))
    outside = text.startswith("/") or ".." in parts or "\\" in text or re.match(r"[A-Za-z]:", text) is not None
    if not parts or outside or not _is_plain(text, limit=4096):
        raise FormatError(
            f"{place}: the path {str(value)[:80]!r} is empty or could leave the source's folder; expected folders and "
            "a file, separated by /",
            path=path,
            reason="path",
            line=line,
        )
    return parts[1:] if parts[0] == "pose_data" and len(parts) > 1 else parts


def sequence_name(value: object, path: Path, place: str, line: int | None) -> str:
    """A sequence's name, a part of its id and its text file's name; raises `FormatError` (`path`) for no plain name."""
    text = value if isinstance(value, str) else ""
    if not text or text in (".", "..") or not _is_plain(text, limit=MAX_NAME) or "/" in text or "\\" in text:
        raise FormatError(
            f"{place}: the name {str(value)[:80]!r}; expected a plain file name such as 000000",
            path=path,
            reason="path",
            line=line,
        )
    return text


def read_json_index(path: Path) -> Mapping[str, Any]:
    """The object of a JSON index, sequence name → what is said about it; raises `FormatError` (`index`, `encoding`)."""
    text = sourcefile.decode(sourcefile.read_bytes(path), path)
    try:
        value = parse_json(text, object_pairs_hook=_once_each)
    except json.JSONDecodeError as error:
        raise FormatError(f"not JSON ({error.msg})", path=path, reason="index", line=error.lineno) from None
    except ValueError as error:
        raise FormatError(f"not JSON that can be read ({error})", path=path, reason="index") from None
    if not isinstance(value, dict) or not value:
        raise FormatError(
            "expected an object of sequence names, as the annotations of KIT-ML or BABEL are", path=path, reason="index"
        )
    return value


def _once_each(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    # JSON allows a name twice, of which Python would keep the last without a word.
    value = dict(pairs)
    if len(value) != len(pairs):
        (twice, _), *_ = Counter(name for name, _ in pairs).most_common(1)
        raise ValueError(f"{twice[:40]!r} is there twice")
    return value


def seconds_of(value: object, what: str, path: Path, place: str) -> float:
    """A number of seconds in a JSON index; raises `FormatError` (`index-entry`) for what is none, or negative."""
    number = float(value) if isinstance(value, int | float) and not isinstance(value, bool) else -1.0
    if not 0.0 <= number < 1e6:
        raise FormatError(
            f"{place}: {what} is {str(value)[:40]}, expected seconds from 0 on", path=path, reason="index-entry"
        )
    return number


def unique(entries: Iterable[Entry], path: Path) -> tuple[tuple[Entry, ...], list[FormatError]]:
    """The first entry of each name, and a problem (`duplicate-id`) for each further one."""
    kept: dict[str, Entry] = {}
    problems: list[FormatError] = []
    for entry in entries:
        first = kept.setdefault(entry.name, entry)
        if first is not entry:
            problems.append(
                FormatError(
                    f"{entry.name!r} is named twice, first in {first.place}",
                    path=path,
                    reason="duplicate-id",
                    line=entry.line,
                )
            )
    return tuple(kept.values()), problems


def _is_plain(text: str, *, limit: int) -> bool:
    return len(text) <= limit and text.isprintable()
