"""Members of untrusted .npz archives: their sizes are limited before they are unpacked, and objects are not unpickled.

An .npz file is a zip of .npy members. Nothing is extracted to disk: a member's name is a key, never a path.
"""

import io
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motionkit.core.errors import FormatError
from motionkit.core.shapes import Float32, Float64
from motionkit.io import npy, pickled_data
from motionkit.io.source import source_file

# Deflate's ratio is at most 1,032, for constant bytes; measurements stay below 10. Small members may be constant.
MAX_RATIO = 200
HARMLESS_BYTES = 1 << 26
BROKEN = (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError, ValueError, OverflowError, IndexError)


@dataclass(frozen=True, eq=False)
class NpzArchive:
    """An open archive, and its path for messages; `in` says whether it has a member (without `.npy`)."""

    path: Path
    zipped: zipfile.ZipFile

    def __contains__(self, key: str) -> bool:
        return f"{key}.npy" in self.zipped.NameToInfo

    @property
    def keys(self) -> list[str]:
        """The names of the members, without `.npy`."""
        return [name.removesuffix(".npy") for name in self.zipped.namelist()]


def peek_keys(path: Path) -> frozenset[str]:
    """Keys in a file's zip directory, empty if it has none; reads no member."""
    try:
        with zipfile.ZipFile(path) as zipped:
            return frozenset(NpzArchive(path, zipped).keys)
    except BROKEN:
        return frozenset()


def open_archive(path: Path, data: bytes) -> NpzArchive:
    """The archive in a file's bytes; raises `FormatError` (`not-what-it-says`, `truncated`)."""
    if not data.startswith(b"PK\x03\x04"):
        raise FormatError(
            f"looks like {source_file.describe_content(data)}, expected an .npz archive",
            path=path,
            reason="not-what-it-says",
        )
    try:
        return NpzArchive(path, zipfile.ZipFile(io.BytesIO(data)))
    except BROKEN as error:
        raise FormatError(f"broken .npz archive ({error})", path=path, reason="truncated") from None


def read_numbers(archive: NpzArchive, key: str, shape: tuple[int | None, ...] | None) -> Float32[np.ndarray, "..."]:
    """A numeric member as float32 that matches `shape` (None: any, as a whole or per axis).

    Raises `FormatError` as `npy.read_npy` does, and with `missing-key` or `too-large`.
    """
    data = _unpack(archive, key)
    with _naming(key):
        return npy.read_npy(archive.path, data, shape)


def read_exact(archive: NpzArchive, key: str, shape: tuple[int | None, ...]) -> Float64[np.ndarray, "..."]:
    """A numeric member as float64 that matches `shape` (None: any size); NaN and empty arrays are allowed.

    For clocks, indices and bounds. Raises `FormatError` as `npy.parse_npy` does, and with `missing-key` or `too-large`.
    """
    return read_plain(archive, key, shape).astype(np.float64)


def read_plain(
    archive: NpzArchive, key: str, shape: tuple[int | None, ...] | None = None, kinds: str = npy.NUMBERS
) -> np.ndarray:
    """A member with its own dtype, which is of `kinds`; NaN is allowed. Raises `FormatError` as `read_exact` does."""
    data = _unpack(archive, key)
    with _naming(key):
        return npy.parse_npy(archive.path, data, shape, kinds)


def read_strings(archive: NpzArchive, key: str) -> tuple[str, ...]:
    """A member of strings (a single string gives one element); raises `FormatError` as `read_exact` does."""
    found = read_plain(archive, key, kinds=npy.STRINGS).ravel().tolist()
    return tuple(value.decode("utf-8", "replace") if isinstance(value, bytes) else value for value in found)


def read_scalar(archive: NpzArchive, key: str) -> str | int | float | None:
    """A member with one number or one string; bytes are decoded.

    None for a Python object that is neither (`pickled_data`). Raises `FormatError` (`missing-key`, `truncated`,
    `channel-count`, `not-a-number`).
    """
    data = _unpack(archive, key)
    with _naming(key):
        if (content := npy.object_content(data)) is not None:
            return pickled_data.parse_scalar(content)
        value = npy.parse_npy(archive.path, data, None, npy.NUMBERS + npy.STRINGS)
        if value.size != 1:
            message = f"array of shape {value.shape}, expected one value"
            raise FormatError(message, path=archive.path, reason="channel-count")
    found: str | int | float | bytes = value.item()
    return found.decode("utf-8", "replace") if isinstance(found, bytes) else found


def _unpack(archive: NpzArchive, key: str) -> bytes:
    info = archive.zipped.NameToInfo.get(f"{key}.npy")
    if info is None:
        held = ", ".join(sorted(archive.keys)[:12])
        raise FormatError(f"no array {key!r}; it holds {held[:200]}", path=archive.path, reason="missing-key")
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):  # others may unpack to any size
        message = f"{key}: compressed otherwise than numpy does"
        raise FormatError(message, path=archive.path, reason="unreadable")
    if info.file_size > min(max(HARMLESS_BYTES, MAX_RATIO * info.compress_size), source_file.MAX_BYTES):
        message = f"{key}: {info.compress_size} bytes that claim to unpack to {info.file_size}"
        raise FormatError(message, path=archive.path, reason="too-large")
    try:
        with archive.zipped.open(info) as member:
            return member.read(info.file_size)  # without a limit, all of it is unpacked whatever it claims
    except BROKEN as error:
        raise FormatError(f"{key}: broken array ({error})", path=archive.path, reason="truncated") from None


@contextmanager
def _naming(key: str) -> Iterator[None]:
    # Errors of a member's content, with its key.
    try:
        yield
    except FormatError as error:
        raise FormatError(f"{key}: {error.message}", path=error.path, reason=error.reason, frame=error.frame) from None
