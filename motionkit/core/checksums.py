"""Files that carry a checksum of their own content, so that damage to any of it is noticed: JSON and safetensors."""

import hashlib
import json
import math
import re
from collections.abc import Mapping
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
