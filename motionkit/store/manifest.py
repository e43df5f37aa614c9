"""The manifest: which files make up a store, with their checksums; its rename is the commit."""

import hashlib
import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import motionkit
from motionkit.checksums import sha256_of
from motionkit.errors import StoreError
from motionkit.store import files
from motionkit.store.schema import FORMAT_NAME, FORMAT_VERSION, MANIFEST_FILE, SEGMENTS_FOLDER, part_number
from motionkit.store.versions import READABLE_VERSIONS

PENDING_SUFFIX = ".new"


@dataclass(frozen=True)
class FileEntry:
    """One file of a store: its size in bytes, sha256 and number of rows."""

    sha256: str
    num_bytes: int
    num_rows: int


@dataclass(frozen=True)
class Manifest:
    """A committed state of a store; `files` maps paths inside the store to their entries, sorted by path.

    It holds no date and no machine name, so equal content gives an equal fingerprint. `next_sequence_index` and
    `next_part` are past every number that was ever given, so that none comes to mean something else.
    """

    num_sequences: int
    num_segments: int
    num_frames: int
    num_skeletons: int
    next_sequence_index: int
    next_part: int
    files: dict[str, FileEntry]
    tool: str = field(default=f"motionkit {motionkit.__version__}")
    format_version: int = FORMAT_VERSION

    @property
    def num_removed_segments(self) -> int:
        """Rows of the parts that no sequence has any more: what `motionkit compact` drops."""
        return sum(self.files[name].num_rows for name in self.parts) - self.num_segments

    @property
    def num_bytes(self) -> int:
        """Bytes of all files that it names."""
        return sum(entry.num_bytes for entry in self.files.values())

    def to_json(self) -> str:
        """The file's text, deterministic."""
        counts = {
            "sequences": self.num_sequences,
            "segments": self.num_segments,
            "frames": self.num_frames,
            "skeletons": self.num_skeletons,
        }
        following = {"sequence_index": self.next_sequence_index, "part": self.next_part}
        free = {"sequence_index": self.num_sequences, "part": _first_free_part(self.parts)}
        document = {
            "format": FORMAT_NAME,
            "format_version": self.format_version,
            "tool": self.tool,
            "counts": counts,
            # Only where removals left gaps, so that a store without them is told by its content alone.
            **({"next": following} if following != free else {}),
            "files": {name: asdict(entry) for name, entry in sorted(self.files.items())},
        }
        return json.dumps(document, indent=2) + "\n"

    @property
    def fingerprint(self) -> str:
        """Hex sha256 of the manifest, which holds the sha256 of every file: equal for equal stores."""
        return hashlib.sha256(self.to_json().encode()).hexdigest()

    @property
    def parts(self) -> tuple[str, ...]:
        """Paths of the segment files inside the store, in order."""
        return _parts_of(self.files)


def _parts_of(names: Iterable[str]) -> tuple[str, ...]:
    return tuple(sorted((name for name in names if name.startswith(f"{SEGMENTS_FOLDER}/")), key=part_number))


def _first_free_part(parts: Iterable[str]) -> int:
    return max(map(part_number, parts), default=-1) + 1


def read_manifest(store: Path) -> Manifest:
    """Read a store's manifest; raises `StoreError` where there is none, or it is damaged or of another version."""
    path = store / MANIFEST_FILE
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise StoreError(
            f"there is no store at {store}: make one with 'motionkit ingest SOURCE --store {store}'"
        ) from None
    except (OSError, ValueError) as error:
        raise StoreError(f"{path} cannot be read as JSON ({error}): restore it from a copy") from None
    if not isinstance(document, dict) or document.get("format") != FORMAT_NAME:
        raise StoreError(f"{path} is not the manifest of a store: its 'format' is not {FORMAT_NAME!r}")
    version = document.get("format_version")
    if version not in READABLE_VERSIONS:
        raise StoreError(
            f"the store {store} has format version {version} and was written by {document.get('tool', 'another')}, "
            f"but motionkit {motionkit.__version__} reads versions {READABLE_VERSIONS[0]} to "
            f"{FORMAT_VERSION}: install the motionkit that wrote it, or ingest the sources again"
        )
    try:
        return _parse(document)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise StoreError(f"{path} is damaged ({type(error).__name__}: {error}): restore it from a copy") from None


def _parse(document: dict[str, Any]) -> Manifest:
    entries = {}
    for name, entry in document["files"].items():
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise ValueError(f"the file name {name!r} leads out of the store")
        entries[name] = FileEntry(str(entry["sha256"]), int(entry["num_bytes"]), int(entry["num_rows"]))
    counts, following = document["counts"], document.get("next", {})
    return Manifest(
        num_sequences=int(counts["sequences"]),
        num_segments=int(counts["segments"]),
        num_frames=int(counts["frames"]),
        num_skeletons=int(counts["skeletons"]),
        files=entries,
        next_sequence_index=int(following.get("sequence_index", counts["sequences"])),
        next_part=int(following.get("part", _first_free_part(_parts_of(entries)))),
        tool=str(document["tool"]),
        format_version=int(document["format_version"]),
    )


def commit_manifest(store: Path, manifest: Manifest) -> None:
    """Write the manifest beside the old one and rename it: from then on the store is the new one."""
    pending = store / (MANIFEST_FILE + PENDING_SUFFIX)
    pending.write_text(manifest.to_json(), encoding="utf-8")
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
    for path in (store / name, store / (name + PENDING_SUFFIX)):
        try:
            content = path.read_bytes()
        except FileNotFoundError:
            continue
        if hashlib.sha256(content).hexdigest() == entry.sha256:
            return content
    return None
