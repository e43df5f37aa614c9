"""Files that carry a checksum of their own content, so that damage to any of it is noticed: JSON and safetensors."""

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
# Not in a string of the header: there its quotes would be escaped.
_TENSORS_CHECKSUM = re.compile(rb'"sha256":"([0-9a-f]{64})"')
# What safetensors allows.
LARGEST_HEADER_BYTES = 100_000_000
PIECE_BYTES = 1 << 20
_CHECKSUM_VALUE = re.compile("sha256:[0-9a-f]{64}")
# A file of more bytes is hashed by `motionkit validate --deep` alone; its size is compared always.
MOST_HASHED_BYTES = 4 * 2**30
_TYPES = {"sha256": str, "num_bytes": int}


def sealed(document: Mapping[str, Any]) -> dict[str, Any]:
    """The document with its checksum under the last key; raises `ValueError` for NaN and infinity."""
    content = {name: value for name, value in document.items() if name != CHECKSUM}
    # As a reader will see it: keys are strings there.
    return {**content, CHECKSUM: checksum_of(json.loads(json.dumps(content, allow_nan=False)))}


def checksum_of(document: Mapping[str, Any]) -> str:
    """`sha256:` and the hexadecimal digest of a document's values: not of its white space or the order of its keys."""
    text = json.dumps(document, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return "sha256:" + hashlib.sha256(text.encode()).hexdigest()


def unsealed(document: Mapping[str, Any]) -> dict[str, Any]:
    """The document without its checksum; raises `ValueError` where the two do not agree.

    A document without a checksum, of before there were any, is given back as it is.
    """
    content = {name: value for name, value in document.items() if name != CHECKSUM}
    if CHECKSUM in document:
        found, expected = document[CHECKSUM], checksum_of(content)
        if found != expected:
            raise ValueError("its content is not what its checksum says")
    elif any(isinstance(value, str) and _CHECKSUM_VALUE.fullmatch(value) for value in content.values()):
        raise ValueError(f"its key {CHECKSUM!r} is damaged")
    return content


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Write a sealed JSON file that appears whole or not at all."""
    write_whole(path, json.dumps(sealed(document), indent=2, allow_nan=False, ensure_ascii=False) + "\n")


def read_json(path: Path, mend: str) -> dict[str, Any]:
    """Read a JSON object and check it; `mend` says what a person does about a damaged one.

    Raises `DamagedFileError` for anything but a whole JSON object that agrees with its checksum, and `OSError` where
    the file cannot be read.
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


def require_intact_tensors(path: Path, mend: str) -> bool:
    """Compare a safetensors file's bytes with the checksum in its header; False where it has none.

    `mend` says what a person does about a damaged file. Raises `DamagedFileError`, or `OSError` for one that cannot be
    read.
    """
    with path.open("rb") as file:
        length = int.from_bytes(file.read(8), "little")
        if length > LARGEST_HEADER_BYTES:
            raise DamagedFileError(path, "not a whole safetensors file: its header is too long", mend)
        header = file.read(length)
        stated = _TENSORS_CHECKSUM.search(header)
        if stated is None:
            return False
        start, end = stated.span(1)
        digest = hashlib.sha256(length.to_bytes(8, "little") + header[:start] + ZEROS + header[end:])
        while piece := file.read(PIECE_BYTES):
            digest.update(piece)
    if digest.hexdigest() != stated[1].decode():
        raise DamagedFileError(path, "its content is not what its checksum says", mend)
    return True


@dataclass(frozen=True)
class FileDigest:
    """What a file has to be: its sha256, hexadecimal, and its size."""

    sha256: str
    num_bytes: int

    def plain(self) -> dict[str, Any]:
        """The digest as JSON holds it."""
        return asdict(self)

    @classmethod
    def parse(cls, value: Any) -> "FileDigest":
        """A digest out of JSON; raises `ValueError` for anything else."""
        if not isinstance(value, dict) or {name: type(each) for name, each in value.items()} != _TYPES:
            raise ValueError(f"{str(value)[:80]!r} is no digest of a file")
        return cls(**value)


def file_fault(path: Path, digest: FileDigest, *, deep: bool = False) -> str:
    """What is wrong with a file, empty where it is the one that the digest was taken of.

    Files above `MOST_HASHED_BYTES` are hashed if `deep`; a file that did not change since is hashed once in a process.
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
