"""Digests of large files: noted when they are written, compared when they are opened."""

import stat
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from motionkit.core.checksums import sha256_of

# A file of more bytes is hashed by `motionkit validate --deep` alone; its size is compared always.
MOST_HASHED_BYTES = 4 * 2**30
_TYPES = {"sha256": str, "num_bytes": int}


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
        """A digest out of JSON; raises `ValueError` for what is none."""
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
