"""Safetensors files with a checksum of their own bytes, to detect damage.

The checksum in the file's metadata is the sha256 of the whole file, header and data, with 64 zeros in its place.
"""

import hashlib
import json
from collections.abc import Callable, Mapping, Set
from pathlib import Path
from typing import TypeVar

from safetensors import SafetensorError, safe_open

from motionkit.core.checksums import ZEROS, require_intact_tensors
from motionkit.core.errors import DamagedFileError
from motionkit.core.files import whole_file

CHECKSUM = "sha256"

TensorT = TypeVar("TensorT")


def write_sealed_tensors(
    path: Path,
    tensors: dict[str, TensorT],
    metadata: Mapping[str, str],
    save: Callable[[dict[str, TensorT], dict[str, str]], bytes],
) -> None:
    """Write a safetensors file with its checksum, atomically.

    `save` is `safetensors.torch.save` or `safetensors.numpy.save`; `save_file` would set its own permissions and raise
    its own error for a full disk.
    """
    content = memoryview(save(tensors, dict(metadata)))
    end = 8 + int.from_bytes(content[:8], "little")
    data = content[end:]
    # safetensors writes several keys of the metadata in an order that differs from call to call.
    described = json.loads(bytes(content[8:end]))
    header = _header(described, metadata, ZEROS)
    digest = hashlib.sha256(header)
    digest.update(data)
    with whole_file(path) as temporary, temporary.open("wb") as file:
        file.write(_header(described, metadata, digest.hexdigest().encode()))
        file.write(data)


def _header(described: Mapping[str, object], metadata: Mapping[str, str], checksum: bytes) -> bytes:
    """A safetensors header with its length, padded to a multiple of 8 bytes."""
    whole = {**described, "__metadata__": {**metadata, CHECKSUM: checksum.decode()}}
    text = json.dumps(whole, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text


def checked_metadata(path: Path, known: Set[str], hint: str) -> dict[str, str]:
    """The metadata of a safetensors file after verifying its checksum; `known` are the allowed keys.

    `hint` tells the user how to repair a damaged file. Raises `DamagedFileError`, and `OSError` if the file cannot be
    read.
    """
    require_intact_tensors(path, hint)
    try:
        with safe_open(path, framework="np") as opened:
            metadata: dict[str, str] = dict(opened.metadata() or {})
    except (SafetensorError, ValueError) as error:
        raise DamagedFileError(path, str(error), hint) from None
    unknown = metadata.keys() - known - {CHECKSUM}
    if unknown:
        raise DamagedFileError(path, f"its header has an unknown key {min(unknown)!r}", hint)
    return metadata
