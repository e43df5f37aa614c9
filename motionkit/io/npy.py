"""Untrusted .npy arrays of numbers or strings: the header is compared with the size before anything is allocated."""

import io
import math
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np

from motionkit.core.errors import FormatError
from motionkit.core.shapes import Float, Float32
from motionkit.io.source import source_file

# A kilometre in millimetres.
MAX_NUMBER = 1e6
# Quaternions of float16 are off unit length by 1e-3.
MAX_LENGTH_ERROR = 0.01


def checked_numbers(array: np.ndarray, path: Path, name: str = "") -> Float32[np.ndarray, "..."]:
    """An array as float32, frames first; raises `FormatError` (`nan`, `range`) with the first bad frame."""
    if array.dtype == np.float16:
        array = array.astype(np.float32)  # a million is beyond the range of float16
    rows = array.reshape(len(array), -1)
    for reason, bad in (("nan", ~np.isfinite(rows)), ("range", (rows > MAX_NUMBER) | (rows < -MAX_NUMBER))):
        if bad.any():
            frame = int(np.flatnonzero(bad.any(axis=1))[0])
            value = rows[frame][bad[frame]][0]
            message = f"{name}{': ' if name else ''}{value} where a number of a body was expected"
            raise FormatError(message, path=path, reason=reason, frame=frame)
    return np.ascontiguousarray(array, dtype=np.float32)


def checked_rotations(rotations: Float[np.ndarray, "frames joints 4"], path: Path, name: str) -> None:
    """Raise `FormatError` (`range`) if the norm of a quaternion differs from 1 by more than 0.01."""
    error = np.abs(np.linalg.norm(rotations, axis=-1) - 1.0).max(axis=1)
    if error.max() > MAX_LENGTH_ERROR:
        raise FormatError(
            f"{name}: a quaternion's length is off 1 by {error.max():.3g}, expected unit quaternions",
            path=path,
            reason="range",
            frame=int(np.argmax(error > MAX_LENGTH_ERROR)),
        )


MAGIC = np.lib.format.MAGIC_PREFIX
# numpy refuses headers of more than 10,000 bytes.
HEADER_BYTES = 1 << 14
NUMBERS, STRINGS = "fiu", "SU"
LARGEST_CHARACTER = 0x10FFFF
LARGEST_SIZE = 1 << 48
MOST_AXES = 32


class Header(NamedTuple):
    """The header of a .npy file."""

    shape: tuple[int, ...]
    column_major: bool
    dtype: np.dtype


def read_header(file: io.BytesIO) -> Header:
    """The header at the beginning of a .npy file, which is read up to the data; raises `ValueError`."""
    readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    try:
        with warnings.catch_warnings(action="ignore"):  # about Python 2's integers
            header = Header(*readers[np.lib.format.read_magic(file)](file))
    except Exception as error:  # numpy evaluates a literal, which fails in many ways
        raise ValueError(f"{type(error).__name__}: {error}"[:200]) from None
    sizes = header.shape
    if len(sizes) > MOST_AXES or not all(type(size) is int and 0 <= size < LARGEST_SIZE for size in sizes):
        raise ValueError("a shape that no array has")
    return header


def peek_shape(path: Path) -> tuple[int, ...] | None:
    """The shape in a .npy file's header, None if it has no valid one; reads no data."""
    try:
        with path.open("rb") as file:
            return read_header(io.BytesIO(file.read(HEADER_BYTES))).shape
    except (OSError, ValueError):
        return None


def object_content(data: bytes) -> bytes | None:
    """The pickle in a .npy file's bytes; None if its header declares plain values, or is invalid."""
    file = io.BytesIO(data)
    try:
        return file.read() if read_header(file).dtype.hasobject else None
    except ValueError:
        return None


def read_npy(path: Path, data: bytes, shape: tuple[int | None, ...] | None) -> Float32[np.ndarray, "..."]:
    """A numeric array as float32 that matches `shape` (`parse_npy`), with finite numbers and no empty axes.

    Raises `FormatError` as `parse_npy` does, and with the reasons `no-frames`, `nan` and `range`.
    """
    array = parse_npy(path, data, shape)
    if 0 in array.shape:
        raise FormatError("0 frames, expected at least one", path=path, reason="no-frames")
    return checked_numbers(np.atleast_1d(array), path).reshape(array.shape)


def parse_npy(path: Path, data: bytes, shape: tuple[int | None, ...] | None, kinds: str = NUMBERS) -> np.ndarray:
    """The array in a file's bytes, of a dtype among `kinds` and of a `shape` (None: any, as a whole or per axis).

    Raises `FormatError` (`not-what-it-says`, `object-array`, `not-a-number`, `channel-count`, `truncated`).
    """
    if not data.startswith(MAGIC):
        raise FormatError(
            f"looks like {source_file.describe_content(data)}, expected a .npy array",
            path=path,
            reason="not-what-it-says",
        )
    file = io.BytesIO(data)
    try:
        header = read_header(file)
    except ValueError as error:
        raise FormatError(f"broken .npy header ({error})", path=path, reason="truncated") from None
    dtype = header.dtype
    if dtype.kind not in kinds or not dtype.itemsize:
        raise FormatError(
            f"array of dtype {str(dtype)[:40]!r}, expected plain {'numbers' if kinds == NUMBERS else 'values'}; Python "
            "objects are not loaded, because they can run code",
            path=path,
            reason="object-array" if dtype.hasobject else "not-a-number",
        )
    if shape is not None and (
        len(header.shape) != len(shape)
        or any(n is not None and n != m for n, m in zip(shape, header.shape, strict=True))
    ):
        expected = ", ".join("any" if n is None else str(n) for n in shape)
        raise FormatError(f"array of shape {header.shape}, expected ({expected})", path=path, reason="channel-count")
    count, start = math.prod(header.shape), file.tell()
    if count * dtype.itemsize != len(data) - start:
        raise FormatError(
            f"the header states {count} values of {dtype.itemsize} bytes, but {len(data) - start} bytes follow",
            path=path,
            reason="truncated",
        )
    flat = np.frombuffer(data, dtype, count, offset=start)
    if dtype.kind == "U" and (flat.view(dtype.byteorder + "u4") > LARGEST_CHARACTER).any():
        raise FormatError("text with characters that do not exist", path=path, reason="not-what-it-says")
    return flat.reshape(header.shape, order="F" if header.column_major else "C")
