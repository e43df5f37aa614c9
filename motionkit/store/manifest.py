"""The manifest: lists a store's files with their checksums, and its own; its rename is the commit."""

import hashlib
import json
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from motionkit.core import __version__, files
from motionkit.core.checksums import read_json, sealed
from motionkit.core.errors import DamagedFileError, StoreError, describe
from motionkit.core.files import sha256_of
from motionkit.store.schema import (
    FORMAT_NAME,
    FORMAT_VERSION,
    MANIFEST_FILE,
    SEGMENTS_FOLDER,
    SEQUENCES_FILE,
    SKELETONS_FILE,
    part_name,
    part_number,
)

PENDING_SUFFIX = ".new"
TABLES = (SEQUENCES_FILE, SKELETONS_FILE)
# Numbers of sequences and of parts are int32 in the tables.
MOST_NUMBERS = 2**31
_MEND = "restore it from a copy, or ingest the sources into a new store"
_SHA256 = re.compile("[0-9a-f]{64}")
_PART = re.compile(rf"{SEGMENTS_FOLDER}/part-[0-9]{{5,10}}\.parquet")


@dataclass(frozen=True)
class FileEntry:
    """One file of a store: its sha256, size in bytes and number of rows.

    `footer_sha256` is that of a part's footer, empty for tables and for parts whose pages
    carry no checksums, as earlier versions wrote them.
    """

    sha256: str
    num_bytes: int
    num_rows: int
    footer_sha256: str = ""

    def plain(self) -> dict[str, Any]:
        """The entry as a JSON object."""
        footer = {"footer_sha256": self.footer_sha256} if self.footer_sha256 else {}
        return {"sha256": self.sha256, "num_bytes": self.num_bytes, "num_rows": self.num_rows, **footer}


@dataclass(frozen=True)
class Manifest:
    """A committed state of a store; `files` maps paths inside the store to their entries, sorted by path.

    It holds no date and no machine name, so equal content gives an equal fingerprint. `next_sequence_index` and
    `next_part` are past every number that was ever given, so that none comes to mean something else. Raises
    `ValueError` where they are not.
    """

    num_sequences: int
    num_segments: int
    num_frames: int
    num_skeletons: int
    next_sequence_index: int
    next_part: int
    files: dict[str, FileEntry]
    tool: str = field(default=f"motionkit {__version__}")
    format_version: int = FORMAT_VERSION

    def __post_init__(self) -> None:
        if not _first_free_part(self.parts) <= self.next_part <= MOST_NUMBERS:
            raise ValueError(f"its next part is {self.next_part}, but it names {self.parts[-1:] or 'none'}")
        if not self.num_sequences <= self.next_sequence_index <= MOST_NUMBERS:
            raise ValueError(f"its next sequence_index is {self.next_sequence_index} of {self.num_sequences} sequences")

    @property
    def num_removed_segments(self) -> int:
        """Rows of the parts that belong to removed sequences: `motionkit compact` drops them."""
        return sum(self.files[name].num_rows for name in self.parts) - self.num_segments

    @property
    def num_bytes(self) -> int:
        """Total bytes of its files."""
        return sum(entry.num_bytes for entry in self.files.values())

    def plain(self) -> dict[str, Any]:
        """The manifest as a JSON object, without the checksum."""
        counts = {
            "sequences": self.num_sequences,
            "segments": self.num_segments,
            "frames": self.num_frames,
            "skeletons": self.num_skeletons,
        }
        following = {"sequence_index": self.next_sequence_index, "part": self.next_part}
        free = {"sequence_index": self.num_sequences, "part": _first_free_part(self.parts)}
        return {
            "format": FORMAT_NAME,
            "format_version": self.format_version,
            "tool": self.tool,
            "counts": counts,
            # Only where removals left gaps, so that a store without them is identified by its content alone.
            **({"next": following} if following != free else {}),
            "files": {name: entry.plain() for name, entry in sorted(self.files.items())},
        }

    @property
    def fingerprint(self) -> str:
        """Hex sha256 of the manifest without its checksum; it holds those of all files: equal for equal stores."""
        return hashlib.sha256(_text(self.plain()).encode()).hexdigest()

    @property
    def parts(self) -> tuple[str, ...]:
        """Paths of the segment files inside the store, in order."""
        return _parts_of(self.files)


def _text(document: dict[str, Any]) -> str:
    return json.dumps(document, indent=2) + "\n"


def _parts_of(names: Iterable[str]) -> tuple[str, ...]:
    return tuple(sorted((name for name in names if name.startswith(f"{SEGMENTS_FOLDER}/")), key=part_number))


def _first_free_part(parts: Iterable[str]) -> int:
    return max(map(part_number, parts), default=-1) + 1


def read_manifest(store: Path) -> Manifest:
    """Read a store's manifest; raises `StoreError` where there is none, or it is damaged or of another version."""
    path = store / MANIFEST_FILE
    try:
        document = read_json(path, _MEND)
    except FileNotFoundError:
        raise StoreError(
            f"there is no store at {store}: make one with 'motionkit ingest SOURCE --store {store}'"
        ) from None
    except NotADirectoryError:
        raise StoreError(
            f"{store} is a file, and a store is a folder: 'motionkit ingest {store}' puts a motion into one, "
            f"'motionkit view {store}' shows it"
        ) from None
    except (OSError, DamagedFileError) as error:
        raise StoreError(describe(error)) from None
    if document.get("format") != FORMAT_NAME:
        raise StoreError(f"{path} is not the manifest of a store: its 'format' is not {FORMAT_NAME!r}")
    version = document.get("format_version")
    if version != FORMAT_VERSION:
        raise StoreError(
            f"the store {store} has format version {version!r} and was written by {document.get('tool', 'another')!r}, "
            f"but motionkit {__version__} reads version {FORMAT_VERSION}: "
            f"install the motionkit that wrote it, or ingest the sources again"
        )
    try:
        return _parse(document)
    except (KeyError, ValueError) as error:
        fault = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise StoreError(
            f"{path} is damaged ({fault}): restore it from a copy, or ingest the sources into a new store"
        ) from None


def _parse(document: dict[str, Any]) -> Manifest:
    stated = _mapping(document, "files")
    entries = {name: _entry(name, _mapping(stated, name)) for name in stated}
    counts, following = _mapping(document, "counts"), _mapping({"next": {}, **document}, "next")
    tool = document["tool"]
    if not isinstance(tool, str) or not tool.isprintable():
        raise ValueError(f"its tool is {tool!r}")
    return Manifest(
        num_sequences=_count(counts, "sequences"),
        num_segments=_count(counts, "segments"),
        num_frames=_count(counts, "frames"),
        num_skeletons=_count(counts, "skeletons"),
        files=entries,
        next_sequence_index=_count(following or counts, "sequence_index" if following else "sequences"),
        next_part=_count(following, "part") if following else _first_free_part(_parts_of(entries)),
        tool=tool,
        format_version=_count(document, "format_version"),
    )


def _entry(name: str, entry: dict[str, Any]) -> FileEntry:
    if name not in TABLES and not (_PART.fullmatch(name) and name == part_name(part_number(name))):
        raise ValueError(f"it names {name!r}, which is no file of a store")
    footer = entry.get("footer_sha256")
    for digest in (entry["sha256"], *([footer] if footer is not None else [])):
        if not isinstance(digest, str) or not _SHA256.fullmatch(digest):
            raise ValueError(f"the sha256 of {name} is {digest!r}")
    return FileEntry(entry["sha256"], _count(entry, "num_bytes"), _count(entry, "num_rows"), footer or "")


def _mapping(document: dict[str, Any], name: str) -> dict[str, Any]:
    value = document[name]
    if not isinstance(value, dict):
        raise ValueError(f"{name} is {str(value)[:40]!r}")
    return value


def _count(values: dict[str, Any], name: str) -> int:
    value = values[name]
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**63:
        raise ValueError(f"{name} is {value!r}")
    return value


def commit_manifest(store: Path, manifest: Manifest) -> None:
    """Writes the manifest beside the old one and renames it, which commits the new state."""
    pending = store / (MANIFEST_FILE + PENDING_SUFFIX)
    with files.naming(pending):
        files.create(pending)
        pending.write_text(_text(sealed(manifest.plain())), encoding="utf-8")
    files.replace(pending, store / MANIFEST_FILE)


def describe_file(path: Path, num_rows: int) -> FileEntry:
    """The manifest's entry for a finished file."""
    return FileEntry(sha256_of(path), path.stat().st_size, num_rows)


def read_committed(store: Path, name: str, entry: FileEntry) -> bytes | None:
    """Content of a table that the manifest names, wherever it lies; None where neither place holds it.

    Tables are written as `name.new`, then the manifest is renamed (the commit), then they get their names; a writer
    that is killed in between leaves a committed table under its pending name until the next writer moves it. The
    checksum says which one it is, also while a writer is at work.
    """
    # The first place again, for a writer may give a table its name between the two.
    for path in (store / name, store / (name + PENDING_SUFFIX), store / name):
        # Both differ while a writer is at work, so the size tells most of the time, and nothing too large is read.
        try:
            if path.stat().st_size != entry.num_bytes:
                continue
            content = path.read_bytes()
        except FileNotFoundError:
            continue
        if hashlib.sha256(content).hexdigest() == entry.sha256:
            return content
    return None
