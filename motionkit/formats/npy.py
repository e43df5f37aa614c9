"""Numeric .npy arrays from strangers: the header is checked against the file before anything is allocated."""

import io
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from motionkit.errors import FormatError
from motionkit.formats import sourcefile

MAGIC = b"\x93NUMPY"
HEADER_BYTES = 10_000


def peek_shape(path: Path) -> tuple[int, ...] | None:
    """Shape that a .npy file's header states, None where there is no such header; reads no data."""
    try:
        with path.open("rb") as file:
            return _header(io.BytesIO(file.read(HEADER_BYTES)))[0]
    except (OSError, ValueError, SyntaxError):
        return None


def read_npy(path: Path, data: bytes, shape: tuple[int | None, ...]) -> Float32[np.ndarray, "..."]:
    """A numeric array as float32 that agrees with `shape` (None: any size).

    Raises `FormatError` (`not-what-it-says`, `object-array`, `channel-count`, `no-frames`, `truncated`, `nan` …).
    """
    if not data.startswith(MAGIC):
        raise FormatError(
            f"looks like {sourcefile.describe_content(data)}, expected a .npy array",
            path=path,
            reason="not-what-it-says",
        )
    file = io.BytesIO(data)
    try:
        stated, column_major, dtype = _header(file)
    except (ValueError, SyntaxError) as error:
        raise FormatError(f"broken .npy header ({error})", path=path, reason="truncated") from None
    if dtype.hasobject or dtype.kind not in "fiu":
        raise FormatError(
            f"array of {dtype}, expected plain numbers; Python objects are not loaded, because they can run code",
            path=path,
            reason="object-array" if dtype.hasobject else "not-a-number",
        )
    if len(stated) != len(shape) or any(n is not None and n != m for n, m in zip(shape, stated, strict=True)):
        expected = ", ".join("any" if n is None else str(n) for n in shape)
        raise FormatError(f"array of shape {stated}, expected ({expected})", path=path, reason="channel-count")
    if 0 in stated:
        raise FormatError("0 frames, expected at least one", path=path, reason="no-frames")
    count = 1
    for size in stated:
        count *= size
    if count * dtype.itemsize != len(data) - file.tell():
        raise FormatError(
            f"the header states {count} numbers of {dtype.itemsize} bytes, but {len(data) - file.tell()} bytes follow",
            path=path,
            reason="truncated",
        )
    flat = np.frombuffer(data, dtype, count, offset=file.tell())
    return _checked(flat.reshape(stated, order="F" if column_major else "C"), path)


def _checked(array: np.ndarray, path: Path) -> Float32[np.ndarray, "..."]:
    rows = array.reshape(len(array), -1)
    for reason, bad in (("nan", ~np.isfinite(rows)), ("range", np.abs(rows) > 1e9)):
        if bad.any():
            frame = int(np.flatnonzero(bad.any(axis=1))[0])
            value = rows[frame][bad[frame]][0]
            raise FormatError(f"{value} where a number of a body was expected", path=path, reason=reason, frame=frame)
    return np.ascontiguousarray(array, dtype=np.float32)


def _header(file: io.BytesIO) -> tuple[tuple[int, ...], bool, np.dtype]:
    version = np.lib.format.read_magic(file)
    if version == (1, 0):
        shape, column_major, dtype = np.lib.format.read_array_header_1_0(file, max_header_size=HEADER_BYTES)
    elif version == (2, 0):
        shape, column_major, dtype = np.lib.format.read_array_header_2_0(file, max_header_size=HEADER_BYTES)
    else:
        raise ValueError(f"version {version[0]}.{version[1]}")
    if any(size < 0 for size in shape):
        raise ValueError(f"shape {shape}")
    return shape, column_major, dtype
