"""Members of untrusted .npz archives: sizes are bounded before anything is unpacked, objects are never unpickled.

An .npz file is a zip of .npy members. Nothing is extracted to disk: a member's name is a key, never a path.
"""

import contextlib
import io
import math
import re
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64

from motionkit.core.errors import FormatError
from motionkit.io.arrays import npy, pickled_data
from motionkit.io.source import source_file

# Deflate's ratio is at most 1,032, for constant bytes; measurements stay below 10. Small members may be constant.
MAX_RATIO = 200
HARMLESS_BYTES = 1 << 26
SCALAR_BYTES = 1 << 14
PLAIN = re.compile(f"{npy.NUMBERS.pattern}|{npy.STRINGS.pattern}")
BROKEN = (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError, ValueError, OverflowError, IndexError)


@dataclass(frozen=True, eq=False)
class NpzArchive:
    """An open archive of `num_bytes`: its path for messages, and its members by key (without `.npy`)."""

    path: Path
    num_bytes: int
    zipped: zipfile.ZipFile
    members: Mapping[str, zipfile.ZipInfo]

    def __contains__(self, key: str) -> bool:
        return key in self.members


def peek_keys(path: Path) -> frozenset[str]:
    """Keys in a file's zip directory, empty if it has none; reads no member."""
    try:
        with zipfile.ZipFile(path) as archive:
            return frozenset(info.filename.removesuffix(".npy") for info in archive.infolist())
    except (*BROKEN, NotImplementedError):
        return frozenset()


def open_archive(path: Path, data: bytes) -> NpzArchive:
    """The archive in a file's bytes; raises `FormatError` (`not-what-it-says`, `truncated`, `duplicate-key`)."""
    if not data.startswith(b"PK\x03\x04"):
        raise FormatError(
            f"looks like {source_file.describe_content(data)}, expected an .npz archive",
            path=path,
            reason="not-what-it-says",
        )
    try:
        zipped = zipfile.ZipFile(io.BytesIO(data))
        for info in zipped.infolist():
            # Compares its name with that in the local header. A member that cannot be unpacked is reported only when
            # it is read, for it may be optional.
            with contextlib.suppress(NotImplementedError, RuntimeError):
                zipped.open(info).close()
    except (*BROKEN, NotImplementedError) as error:
        raise FormatError(f"broken .npz archive ({error})", path=path, reason="truncated") from None
    members: dict[str, zipfile.ZipInfo] = {}
    for info in zipped.infolist():
        if members.setdefault(info.filename.removesuffix(".npy"), info) is not info:
            raise FormatError(f"holds {info.filename!r} twice", path=path, reason="duplicate-key")
    return NpzArchive(path, len(data), zipped, members)


def read_header(archive: NpzArchive, key: str) -> tuple[tuple[int, ...], bool, str]:
    """The contents of a member's header (`npy.read_header`); raises `FormatError` as `read_shape` does."""
    info = _checked_info(archive, key)
    try:
        return npy.read_header(io.BytesIO(_unpack(archive, info, npy.HEADER_BYTES)))
    except ValueError as error:
        raise _broken(archive, key, error) from None


def read_shape(archive: NpzArchive, key: str) -> tuple[int, ...]:
    """Shape in a member's header; raises `FormatError` (`missing-key`, `truncated`, `too-large`)."""
    return read_header(archive, key)[0]


def read_numbers(archive: NpzArchive, key: str, shape: tuple[int | None, ...]) -> Float32[np.ndarray, "..."]:
    """A numeric member as float32 that matches `shape` (None: any size).

    Raises `FormatError` as `npy.read_npy` does, and with `missing-key` or `too-large`.
    """
    data = _unpack(archive, _checked_info(archive, key))
    try:
        return npy.read_npy(archive.path, data, shape)
    except FormatError as error:
        raise _named(key, error, frame=error.frame if len(shape) > 1 else None) from None


def read_exact(archive: NpzArchive, key: str, shape: tuple[int | None, ...]) -> Float64[np.ndarray, "..."]:
    """A numeric member as float64 that matches `shape` (None: any size); NaN and empty arrays are allowed.

    For clocks, indices and bounds. Raises `FormatError` as `npy.parse_npy` does, and with `missing-key` or `too-large`.
    """
    return _parse(archive, key, shape, npy.NUMBERS).astype(np.float64)


def read_plain(archive: NpzArchive, key: str) -> np.ndarray:
    """A numeric member with its own shape and type; NaN is allowed. Raises `FormatError` as `read_exact` does."""
    return _parse(archive, key, None, npy.NUMBERS)


def read_strings(archive: NpzArchive, key: str) -> tuple[str, ...]:
    """A member of strings (a single string gives one element); raises `FormatError` as `read_exact` does."""
    found = _parse(archive, key, None, npy.STRINGS).ravel()
    try:
        return tuple(str(value.decode() if isinstance(value, bytes) else value) for value in found.tolist())
    except UnicodeDecodeError as error:
        raise _broken(archive, key, error) from None


def read_scalar(archive: NpzArchive, key: str) -> str | int | float | None:
    """A member with one number or one string, of any type; bytes are decoded.

    None for an object whose pickle is more than one constant (`pickled_data`): nothing is unpickled. Raises
    `FormatError` (`missing-key`, `truncated`, `channel-count`, `not-a-number`).
    """
    info = _checked_info(archive, key)
    if info.file_size > SCALAR_BYTES:
        raise FormatError(
            f"{key}: {info.file_size} bytes, expected one value", path=archive.path, reason="channel-count"
        )
    file = io.BytesIO(_unpack(archive, info))
    try:
        shape, _, code = npy.read_header(file)
    except ValueError as error:
        raise _broken(archive, key, error) from None
    if math.prod(shape) != 1:
        raise FormatError(
            f"{key}: array of shape {shape}, expected one value", path=archive.path, reason="channel-count"
        )
    if code in ("|O", "O"):
        return pickled_data.parse_scalar(file.read())
    value: str | int | float | bytes = _parse(archive, key, shape, PLAIN).item()
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value


def _parse(archive: NpzArchive, key: str, shape: tuple[int | None, ...] | None, codes: re.Pattern[str]) -> np.ndarray:
    data = _unpack(archive, _checked_info(archive, key))
    try:
        return npy.parse_npy(archive.path, data, shape, codes)
    except FormatError as error:
        raise _named(key, error) from None
    except ValueError as error:  # characters beyond Unicode's
        raise _broken(archive, key, error) from None


def _named(key: str, error: FormatError, frame: int | None = None) -> FormatError:
    return FormatError(f"{key}: {error.message}", path=error.path, reason=error.reason, frame=frame)


def _checked_info(archive: NpzArchive, key: str) -> zipfile.ZipInfo:
    info = archive.members.get(key)
    if info is None:
        held = ", ".join(sorted(archive.members)[:12])
        raise FormatError(f"no array {key!r}; it holds {held[:200]}", path=archive.path, reason="missing-key")
    if info.flag_bits & 1 or info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise FormatError(
            f"{key}: encrypted, or compressed otherwise than numpy does", path=archive.path, reason="unreadable"
        )
    if info.compress_size > archive.num_bytes:
        raise FormatError(
            f"{key}: {info.compress_size} bytes by the zip directory, but the file has {archive.num_bytes}",
            path=archive.path,
            reason="truncated",
        )
    if info.file_size > max(HARMLESS_BYTES, MAX_RATIO * info.compress_size) or info.file_size > source_file.MAX_BYTES:
        raise FormatError(
            f"{key}: {info.compress_size} bytes that claim to unpack to {info.file_size}",
            path=archive.path,
            reason="too-large",
        )
    return info


def _unpack(archive: NpzArchive, info: zipfile.ZipInfo, num_bytes: int = -1) -> bytes:
    # All of a member, or its beginning; zipfile stops at the size that the directory states.
    try:
        with archive.zipped.open(info) as member:
            return member.read(num_bytes)
    except (*BROKEN, NotImplementedError) as error:
        raise _broken(archive, info.filename, error) from None


def _broken(archive: NpzArchive, key: str, error: Exception) -> FormatError:
    return FormatError(f"{key}: broken array ({error})", path=archive.path, reason="truncated")
