"""The entries of an index, each a named segment of a file, and the checks shared by all kinds of index."""

import json
import re
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

from motionkit.core.errors import FormatError
from motionkit.core.motion import Caption
from motionkit.core.plain_text import parse_json
from motionkit.io.scan.cuts import Cut
from motionkit.io.source import source_file

Key = tuple[str, ...]
Row = TypeVar("Row")

# SMPL+H files are called NAME_poses, SMPL-X files NAME_stageii.
ENDINGS = ("_poses", "_stageii")


@dataclass(frozen=True)
class Dataset:
    """A dataset of AMASS: its folder's name in the first release, and how HumanML3D read its files.

    `trim_frames` are dropped before frames are counted; `seen_fps` is the framerate that its code read where a file may
    state another, by the subject's folder, under "" for all others.
    """

    name: str
    trim_frames: int = 0
    seen_fps: Mapping[str, float] = field(default_factory=dict)

    def seen_fps_of(self, parts: Sequence[str]) -> float | None:
        """The framerate that HumanML3D's code read for a file, by its path; None if only the file states it."""
        return next((self.seen_fps[part] for part in (*parts, "") if part in self.seen_fps), None)


def dataset_of(parts: Sequence[str]) -> tuple[Dataset, int] | None:
    """The dataset named by a path's folders, and that folder's position; the last of several, since some are nested."""
    known = _known()
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
def _known() -> Mapping[str, Dataset]:
    table = tomllib.loads(resources.files(__package__).joinpath("datasets.toml").read_text(encoding="utf-8"))
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


MAX_NAME = 120


@dataclass(frozen=True)
class Entry:
    """A sequence of an index: the file, the segment of it, and its annotations.

    `parts` is the file's path as the index spells it. `cut` None takes the whole file; `place` is the entry's location
    in the index, for messages, and `line` its line if there are lines.
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
        """The file's normalised path (`file_key`)."""
        return file_key(self.parts)

    @property
    def dataset(self) -> str:
        """Name of the file's dataset; the first folder's name if the dataset is unknown."""
        found = dataset_of(self.parts)
        return found[0].name if found else (self.parts[0] if len(self.parts) > 1 else "")


@dataclass(frozen=True)
class Index:
    """An index: its name, a prefix of its sequences' ids; its entries; and the rows that could not be used.

    `in_published_frames`: its segments are `StepCut`s, and each has a mirrored copy without a row.
    """

    name: str
    path: Path
    entries: tuple[Entry, ...]
    problems: tuple[FormatError, ...] = field(default=())
    in_published_frames: bool = False


def source_parts(value: object, path: Path, place: str, line: int | None) -> tuple[str, ...]:
    """The parts of a path in an index; raises `FormatError` (`path`) for one that could leave the source's folder.

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
    """A sequence's name, part of its id and its text file's name; raises `FormatError` (`path`) if it is not plain."""
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
    """The object of a JSON index, sequence name → its annotations; raises `FormatError` (`index`, `encoding`)."""
    text = source_file.decode(source_file.read_bytes(path), path)
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
    # JSON allows duplicate names, of which Python would silently keep the last.
    value = dict(pairs)
    if len(value) != len(pairs):
        (twice, _), *_ = Counter(name for name, _ in pairs).most_common(1)
        raise ValueError(f"{twice[:40]!r} is there twice")
    return value


def seconds_of(value: object, what: str, path: Path, place: str) -> float:
    """A number of seconds in a JSON index; raises `FormatError` (`index-entry`) if it is no number, or negative."""
    number = float(value) if isinstance(value, int | float) and not isinstance(value, bool) else -1.0
    if not 0.0 <= number < 1e6:
        raise FormatError(
            f"{place}: {what} is {str(value)[:40]}, expected seconds from 0 on", path=path, reason="index-entry"
        )
    return number


def read_entries(
    name: str, path: Path, rows: Iterable[Row], entry_of: Callable[[Row], Entry], *, in_published_frames: bool = False
) -> Index:
    """The index built from rows; unusable rows and duplicate names (`duplicate-id`) become problems."""
    kept: dict[str, Entry] = {}
    problems: list[FormatError] = []
    repeated: list[FormatError] = []
    for row in rows:
        try:
            entry = entry_of(row)
        except FormatError as problem:
            problems.append(problem)
            continue
        first = kept.setdefault(entry.name, entry)
        if first is not entry:
            message = f"{entry.name!r} is named twice, first in {first.place}"
            repeated.append(FormatError(message, path=path, reason="duplicate-id", line=entry.line))
    return Index(name, path, tuple(kept.values()), (*problems, *repeated), in_published_frames)


def _is_plain(text: str, *, limit: int) -> bool:
    return len(text) <= limit and text.isprintable()
