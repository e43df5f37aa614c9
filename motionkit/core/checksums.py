"""JSON and safetensors files with a checksum of their own content, to detect damage."""

import hashlib
import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from motionkit.core.errors import DamagedFileError
from motionkit.core.files import write_whole

CHECKSUM = "checksum"
# In the metadata of a safetensors file: the sha256 of the whole file with zeros in its place.
ZEROS = b"0" * 64
# Not matched inside a string of the header, where its quotes would be escaped.
_TENSORS_CHECKSUM = re.compile(rb'"sha256":"([0-9a-f]{64})"')
# What safetensors allows.
LARGEST_HEADER_BYTES = 100_000_000
PIECE_BYTES = 1 << 20
_CHECKSUM_VALUE = re.compile("sha256:[0-9a-f]{64}")


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


def read_json(path: Path, hint: str) -> dict[str, Any]:
    """Read a JSON object and verify it; `hint` tells the user how to repair a damaged file.

    Raises `DamagedFileError` for anything but a complete JSON object that matches its checksum, and `OSError` if the
    file cannot be read.
    """
    try:
        document = json.loads(path.read_bytes(), parse_constant=_finite, parse_float=_finite)
        if not isinstance(document, dict):
            raise ValueError("it is not a JSON object")
        return unsealed(document)
    except (ValueError, RecursionError) as error:
        raise DamagedFileError(path, str(error), hint) from None


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text} is not a finite number")
    return value


def require_whole_tensors(path: Path, hint: str) -> re.Match[bytes]:
    """Verify the size of a safetensors file, and that it has a checksum; returns the checksum's place in its header.

    `hint` tells the user how to repair a damaged file. Raises `DamagedFileError`, or `OSError` for one that cannot be
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
        raise DamagedFileError(path, "it is not a whole safetensors file", hint)
    stated = _TENSORS_CHECKSUM.search(header)
    if stated is None:
        raise DamagedFileError(path, "it has no checksum", hint)
    return stated


def require_intact_tensors(path: Path, hint: str) -> None:
    """Verify a safetensors file by the checksum in its header; errors as in `require_whole_tensors`."""
    stated = require_whole_tensors(path, hint)
    header, (start, end) = stated.string, stated.span(1)
    digest = hashlib.sha256(len(header).to_bytes(8, "little") + header[:start] + ZEROS + header[end:])
    with path.open("rb") as file:
        file.seek(8 + len(header))
        while piece := file.read(PIECE_BYTES):
            digest.update(piece)
    if digest.hexdigest() != stated[1].decode():
        raise DamagedFileError(path, "its content is not what its checksum says", hint)
