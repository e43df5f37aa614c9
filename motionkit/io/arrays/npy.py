"""Untrusted .npy arrays of numbers or strings: the header is checked against the bytes before use."""

import ast
import io
import math
import re
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32

from motionkit.core.errors import FormatError
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


MAGIC = b"\x93NUMPY"
HEADER_BYTES = 10_000
LARGEST_CHARACTER = 0x10FFFF
LARGEST_SIZE = 2**48
NUMBERS = re.compile(r"[<>|=]?(f[248]|[iu][1248])")
STRINGS = re.compile(r"[<>|=]?[US][1-9]\d{0,6}")


def peek_shape(path: Path) -> tuple[int, ...] | None:
    """Shape in a .npy file's header, None if it has no valid header; reads no data."""
    found = peek_header(path)
    return None if found is None else found[0]


def peek_header(path: Path) -> tuple[tuple[int, ...], bool, str] | None:
    """The contents of a .npy file's header (`read_header`), None if it has no valid header; reads no data."""
    try:
        with path.open("rb") as file:
            return read_header(io.BytesIO(file.read(HEADER_BYTES)))
    except (OSError, ValueError):
        return None


def read_npy(path: Path, data: bytes, shape: tuple[int | None, ...]) -> Float32[np.ndarray, "..."]:
    """A numeric array as float32 that matches `shape` (None: any size), with finite numbers and no empty axes.

    Raises `FormatError` as `parse_npy` does, and with the reasons `no-frames`, `nan` and `range`.
    """
    array = parse_npy(path, data, shape)
    if 0 in array.shape:
        raise FormatError("0 frames, expected at least one", path=path, reason="no-frames")
    return checked_numbers(array, path)


def parse_npy(
    path: Path, data: bytes, shape: tuple[int | None, ...] | None, codes: re.Pattern[str] = NUMBERS
) -> np.ndarray:
    """The array in a file's bytes, with a type among `codes` and a `shape` (None: any, as a whole or per axis).

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
        stated, column_major, code = read_header(file)
    except ValueError as error:
        raise FormatError(f"broken .npy header ({error})", path=path, reason="truncated") from None
    if not codes.fullmatch(code):
        raise FormatError(
            f"array of {code[:40]!r}, expected plain {'numbers' if codes is NUMBERS else 'values'}; Python objects are "
            "not loaded, because they can run code",
            path=path,
            reason="object-array" if "O" in code else "not-a-number",
        )
    if shape is not None and (
        len(stated) != len(shape) or any(n is not None and n != m for n, m in zip(shape, stated, strict=True))
    ):
        expected = ", ".join("any" if n is None else str(n) for n in shape)
        raise FormatError(f"array of shape {stated}, expected ({expected})", path=path, reason="channel-count")
    dtype, count = np.dtype(code), math.prod(stated)
    if count * dtype.itemsize != len(data) - file.tell():
        raise FormatError(
            f"the header states {count} values of {dtype.itemsize} bytes, but {len(data) - file.tell()} bytes follow",
            path=path,
            reason="truncated",
        )
    flat = np.frombuffer(data, dtype, count, offset=file.tell())
    if dtype.kind == "U" and (flat.view(dtype.byteorder + "u4") > LARGEST_CHARACTER).any():
        raise FormatError("text with characters that do not exist", path=path, reason="not-what-it-says")
    return flat.reshape(stated, order="F" if column_major else "C")


def read_header(file: io.BytesIO) -> tuple[tuple[int, ...], bool, str]:
    """Shape, Fortran order and type code, from the header of a .npy file; raises `ValueError`.

    The header is a Python literal of a dictionary (numpy's NEP 1); it is parsed here so that it cannot name a type
    other than plain numbers.
    """
    magic = file.read(8)
    if magic[:6] != MAGIC or magic[6:] not in (b"\x01\x00", b"\x02\x00"):
        raise ValueError("neither version 1.0 nor 2.0")
    width = 2 if magic[6] == 1 else 4
    length = int.from_bytes(file.read(width), "little")
    text = file.read(min(length, HEADER_BYTES))
    if len(text) != length:
        raise ValueError(f"{length} bytes long")
    try:
        header = ast.literal_eval(text.decode("latin-1").strip())
        shape, column_major, code = header["shape"], header["fortran_order"], header["descr"]
    except (ValueError, SyntaxError, TypeError, KeyError, IndexError, RecursionError, MemoryError):
        raise ValueError("not a dictionary with shape, fortran_order and descr") from None
    if not (isinstance(shape, tuple) and all(type(size) is int and 0 <= size < LARGEST_SIZE for size in shape)):
        raise ValueError("a shape that no array has")
    return shape, column_major is True, str(code)
