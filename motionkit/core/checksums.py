"""JSON and safetensors files with a checksum of their own content, to detect damage."""

import hashlib
import json
import math
import re
import stat
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from motionkit.core.errors import DamagedFileError
from motionkit.core.files import read_regular, write_whole

CHECKSUM = "checksum"
# In the metadata of a safetensors file: the sha256 of the whole file with zeros in its place.
ZEROS = b"0" * 64
# Not matched inside a string of the header, where its quotes would be escaped.
_TENSORS_CHECKSUM = re.compile(rb'"sha256":"([0-9a-f]{64})"')
# What safetensors allows.
LARGEST_HEADER_BYTES = 100_000_000
PIECE_BYTES = 1 << 20
_CHECKSUM_VALUE = re.compile("sha256:[0-9a-f]{64}")
# Larger files are only hashed by `motionkit validate --deep`; their size is always compared.
MOST_HASHED_BYTES = 4 * 2**30
_TYPES = {"sha256": str, "num_bytes": int}


def sealed(document: Mapping[str, Any]) -> dict[str, Any]:
    """Add a checksum to a document, as the last key; raises `ValueError` for NaN and infinity."""
    content = {name: value for name, value in document.items() if name != CHECKSUM}
    # As a reader sees it, with string keys.
    return {**content, CHECKSUM: checksum_of(json.loads(json.dumps(content, allow_nan=False)))}


def checksum_of(document: Mapping[str, Any]) -> str:
    """`sha256:` and the hexadecimal digest of a document's values, independent of white space and key order."""
    text = json.dumps(document, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return "sha256:" + hashlib.sha256(text.encode()).hexdigest()


def unsealed(document: Mapping[str, Any]) -> dict[str, Any]:
    """Verify and remove a document's checksum; raises `ValueError` if it does not match.

    A document of an older version without a checksum is returned unchanged.
    """
    content = {name: value for name, value in document.items() if name != CHECKSUM}
    if CHECKSUM in document:
        found, expected = document[CHECKSUM], checksum_of(content)
        if found != expected:
            raise ValueError("its content does not match its checksum")
    elif any(isinstance(value, str) and _CHECKSUM_VALUE.fullmatch(value) for value in content.values()):
        raise ValueError(f"its key {CHECKSUM!r} is damaged")
    return content


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Write a JSON file with its checksum, atomically."""
    write_whole(path, json.dumps(sealed(document), indent=2, allow_nan=False, ensure_ascii=False) + "\n")


def read_json(path: Path, mend: str) -> dict[str, Any]:
    """Read a JSON object and verify it; `mend` tells the user how to repair a damaged file.

    Raises `DamagedFileError` for anything but a complete JSON object that matches its checksum, and `OSError` if the
    file cannot be read.
    """
    try:
        document = json.loads(read_regular(path), parse_constant=_finite, parse_float=_finite)
        if not isinstance(document, dict):
            raise ValueError("it is not a JSON object")
        return unsealed(document)
    except (ValueError, RecursionError) as error:
        raise DamagedFileError(path, str(error), mend) from None


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text} is not a finite number")
    return value


def sha256_of(path: Path) -> str:
    """Hexadecimal sha256 of a file's content, read in pieces."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def require_whole_tensors(path: Path, mend: str) -> re.Match[bytes]:
    """Verify the size of a safetensors file, and that it has a checksum; returns the checksum's place in its header.

    `mend` tells the user how to repair a damaged file. Raises `DamagedFileError`, or `OSError` for one that cannot be
    read.
    """
    with path.open("rb") as file:
        length = int.from_bytes(file.read(8), "little")
        header = file.read(length) if length <= LARGEST_HEADER_BYTES else b""
    try:
        ends = [each["data_offsets"][1] for name, each in json.loads(header).items() if name != "__metadata__"]
        is_whole = 8 + length + max(ends, default=0) == path.stat().st_size
    except (ValueError, RecursionError, LookupError, TypeError, AttributeError):
        is_whole = False
    if not is_whole:
        raise DamagedFileError(path, "it is not a whole safetensors file", mend)
    stated = _TENSORS_CHECKSUM.search(header)
    if stated is None:
        raise DamagedFileError(path, "it has no checksum", mend)
    return stated


def require_intact_tensors(path: Path, mend: str) -> None:
    """Verify a safetensors file by the checksum in its header; errors as in `require_whole_tensors`."""
    stated = require_whole_tensors(path, mend)
    header, (start, end) = stated.string, stated.span(1)
    digest = hashlib.sha256(len(header).to_bytes(8, "little") + header[:start] + ZEROS + header[end:])
    with path.open("rb") as file:
        file.seek(8 + len(header))
        while piece := file.read(PIECE_BYTES):
            digest.update(piece)
    if digest.hexdigest() != stated[1].decode():
        raise DamagedFileError(path, "its content is not what its checksum says", mend)


@dataclass(frozen=True)
class FileDigest:
    """A file's expected sha256 (hexadecimal) and size."""

    sha256: str
    num_bytes: int

    def plain(self) -> dict[str, Any]:
        """The digest as JSON."""
        return asdict(self)

    @classmethod
    def parse(cls, value: Any) -> "FileDigest":
        """Parse a digest from JSON; raises `ValueError` for anything else."""
        if not isinstance(value, dict) or {name: type(each) for name, each in value.items()} != _TYPES:
            raise ValueError(f"{str(value)[:80]!r} is no digest of a file")
        return cls(**value)


def file_fault(path: Path, digest: FileDigest, *, deep: bool = False) -> str:
    """The difference between a file and its digest; empty if they match.

    Files above `MOST_HASHED_BYTES` are only hashed if `deep`; an unchanged file is hashed once per process.
    """
    try:
        status = path.stat()
    except FileNotFoundError:
        return "it is missing"
    if not stat.S_ISREG(status.st_mode):
        return "it is no file"
    if status.st_size != digest.num_bytes:
        return f"it has {status.st_size:,} bytes instead of {digest.num_bytes:,}"
    if not deep and status.st_size > MOST_HASHED_BYTES:
        return ""
    version = (status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns)
    return "" if _sha256_of_version(path, version) == digest.sha256 else "its content is not what was written"


@lru_cache(maxsize=256)
def _sha256_of_version(path: Path, version: tuple[int, ...]) -> str:
    return sha256_of(path)
