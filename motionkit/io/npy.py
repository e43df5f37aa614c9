"""Untrusted numpy files: .npy arrays, .npz archives, and plain data in the pickles that numpy writes.

What a file claims is compared with its size before anything is allocated. Of Python objects only plain data is read:
numbers, texts, lists, dictionaries, and arrays of these. `np.save(path, {"motion": …})` writes such a pickle, many
systems publish their samples this way, Guo his lists of words, and AMASS has a `gender` like this.
"""

import io
import math
import pickle
import re
import warnings
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from motionkit.core.errors import FormatError
from motionkit.core.shapes import Float32, Float64
from motionkit.io import source_file

MAGIC = np.lib.format.MAGIC_PREFIX
# numpy refuses headers of more than 10,000 bytes.
HEADER_BYTES = 1 << 14
NUMBERS, STRINGS = "fiu", "SU"
LARGEST_CHARACTER = 0x10FFFF
# A kilometre in millimetres.
MAX_NUMBER = 1e6
# Deflate's ratio is at most 1,032, for constant bytes; measurements stay below 10. Small members may be constant.
MAX_RATIO, HARMLESS_BYTES = 200, 1 << 26
BROKEN_ZIP = (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError, ValueError, OverflowError, IndexError)

Shape = tuple[int | None, ...] | None
"""The expected shape of an array: None for any, as a whole or per axis."""


def read_npy(path: Path, data: bytes, shape: Shape, *, fill_missing: bool = False) -> Float32[np.ndarray, "..."]:
    """The numbers in a .npy file's bytes as float32; raises `FormatError` as `parse_npy` and `checked_numbers` do."""
    return checked_numbers(parse_npy(path, data, shape), path, fill_missing=fill_missing)


def parse_npy(path: Path, data: bytes, shape: Shape, kinds: str = NUMBERS, name: str = "") -> np.ndarray:
    """The array in a .npy file's bytes, of a dtype among `kinds`; `name` is that of an archive's member.

    Raises `FormatError` (`not-what-it-says`, `object-array`, `not-a-number`, `channel-count`, `truncated`).
    """

    def fault(message: str, reason: str) -> FormatError:
        return FormatError(f"{name}: {message}" if name else message, path=path, reason=reason)

    if not data.startswith(MAGIC):
        raise fault(f"looks like {source_file.describe_content(data)}, expected a .npy array", "not-what-it-says")
    try:
        sizes, column_major, dtype, start = _header(data)
        if dtype.kind not in kinds or not dtype.itemsize:
            if dtype.hasobject:
                raise fault("Python objects, which can run code, where plain values were expected", "object-array")
            raise fault(f"array of dtype {str(dtype)[:40]!r}, expected plain values", "not-a-number")
        if math.prod(sizes) * dtype.itemsize != len(data) - start:
            raise ValueError(f"{len(data) - start} bytes are not of the shape that its header states")
        array = np.frombuffer(data, dtype, math.prod(sizes), start).reshape(sizes, order="F" if column_major else "C")
    except (ValueError, TypeError) as error:
        raise fault(f"broken .npy array ({error})", "truncated") from None
    if dtype.kind == "U" and (array.reshape(-1).view(dtype.byteorder + "u4") > LARGEST_CHARACTER).any():
        raise fault("text with characters that do not exist", "not-what-it-says")
    if shape is None or (
        len(shape) == array.ndim and all(n in (None, m) for n, m in zip(shape, array.shape, strict=True))
    ):
        return array
    expected = ", ".join("any" if size is None else str(size) for size in shape)
    raise fault(f"array of shape {array.shape}, expected ({expected})", "channel-count")


def _header(data: bytes) -> tuple[tuple[int, ...], bool, np.dtype, int]:
    """Shape, whether columns come first, dtype, and the offset of the content; raises `ValueError`."""
    file = io.BytesIO(data)
    readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    try:
        with warnings.catch_warnings(action="ignore"):  # about Python 2's integers
            sizes, column_major, dtype = readers[np.lib.format.read_magic(file)](file)
    except Exception as error:  # numpy evaluates a literal, which fails in many ways
        raise ValueError(f"{type(error).__name__}: {error}"[:200]) from None
    return sizes, column_major, dtype, file.tell()


def peek_shape(path: Path) -> tuple[int, ...] | None:
    """The shape in a .npy file's header, None if it has no valid one; reads no data."""
    try:
        with path.open("rb") as file:
            return _header(file.read(HEADER_BYTES))[0]
    except (OSError, ValueError):
        return None


def checked_numbers(
    array: np.ndarray, path: Path, name: str = "", *, fill_missing: bool = False
) -> Float32[np.ndarray, "..."]:
    """An array as float32, frames first; with `fill_missing`, frames with NaN repeat the last valid one.

    Raises `FormatError` for an empty one (`no-frames`), and with the first frame that has NaN (`nan`) or a number
    beyond a million (`range`).
    """
    label = f"{name}: " if name else ""
    if array.size == 0:
        raise FormatError(f"{label}0 frames, expected at least one", path=path, reason="no-frames")
    if array.dtype == np.float16:
        array = array.astype(np.float32)  # a million is beyond the range of float16
    rows = array.reshape(len(array) if array.ndim else 1, -1)
    if fill_missing:
        rows = rows[source_file.last_valid(np.isfinite(rows).all(axis=1), path)]
        array = rows.reshape(array.shape)
    for reason, bad in (("nan", ~np.isfinite(rows)), ("range", (rows > MAX_NUMBER) | (rows < -MAX_NUMBER))):
        if bad.any():
            frame = int(np.flatnonzero(bad.any(axis=1))[0])
            message = f"{label}{rows[frame][bad[frame]][0]} where a number of a body was expected"
            raise FormatError(message, path=path, reason=reason, frame=frame)
    return np.asarray(array, dtype=np.float32, order="C")


@dataclass(frozen=True, eq=False)
class Archive:
    """An open .npz file; `in` says whether it has an array. A member's name is a key, never a path.

    Its methods raise `FormatError` as `parse_npy` does, and with the reasons `missing-key` and `too-large`.
    """

    path: Path
    zipped: zipfile.ZipFile

    def __contains__(self, key: str) -> bool:
        return f"{key}.npy" in self.zipped.NameToInfo

    @property
    def keys(self) -> list[str]:
        """The names of the arrays."""
        return [name.removesuffix(".npy") for name in self.zipped.namelist()]

    def array(self, key: str, shape: Shape = None, kinds: str = NUMBERS) -> np.ndarray:
        """An array with its own dtype, which is of `kinds`; NaN is allowed."""
        return parse_npy(self.path, self._content(key), shape, kinds, key)

    def numbers(self, key: str, shape: Shape, *, fill_missing: bool = False) -> Float32[np.ndarray, "..."]:
        """An array as float32, checked by `checked_numbers`."""
        return checked_numbers(self.array(key, shape), self.path, key, fill_missing=fill_missing)

    def exact(self, key: str, shape: Shape) -> Float64[np.ndarray, "..."]:
        """An array as float64, for clocks, indices and bounds; NaN and empty arrays are allowed."""
        return self.array(key, shape).astype(np.float64)

    def strings(self, key: str) -> tuple[str, ...]:
        """An array of strings; a single string gives one element, a missing array none."""
        values = self.array(key, None, STRINGS).ravel().tolist() if key in self else []
        return tuple(value.decode("utf-8", "replace") if isinstance(value, bytes) else value for value in values)

    def text(self, key: str) -> str:
        """One string, also if it was saved as a Python object; empty without one."""
        value = self.scalar(key) if key in self else None
        return value if isinstance(value, str) else ""

    def scalar(self, key: str) -> str | int | float | None:
        """One number or one string, also if it was saved as a Python object; None for any other object."""
        try:
            value = read_object(self.path, self._content(key), key)
        except FormatError as error:
            if error.reason == "pickle":
                return None
            raise
        if isinstance(value, np.ndarray) and value.dtype != object:
            message = f"{key}: array of shape {value.shape}, expected one value"
            raise FormatError(message, path=self.path, reason="channel-count")
        value = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
        return value if isinstance(value, (str, int, float)) else None

    def _content(self, key: str) -> bytes:
        info = self.zipped.NameToInfo.get(f"{key}.npy")
        if info is None:
            names = ", ".join(sorted(self.keys)[:12])
            raise FormatError(f"no array {key!r}; it holds {names[:200]}", path=self.path, reason="missing-key")
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):  # others may unpack to any size
            raise FormatError(f"{key}: compressed otherwise than numpy does", path=self.path, reason="unreadable")
        if info.file_size > min(max(HARMLESS_BYTES, MAX_RATIO * info.compress_size), source_file.MAX_BYTES):
            message = f"{key}: {info.compress_size} bytes that claim to unpack to {info.file_size}"
            raise FormatError(message, path=self.path, reason="too-large")
        try:
            with self.zipped.open(info) as member:
                return member.read(info.file_size)  # without a limit, all of it is unpacked whatever it claims
        except BROKEN_ZIP as error:
            raise FormatError(f"{key}: broken array ({error})", path=self.path, reason="truncated") from None


def open_archive(path: Path, data: bytes) -> Archive:
    """The archive in an .npz file's bytes; raises `FormatError` (`not-what-it-says`, `truncated`)."""
    if not data.startswith(b"PK\x03\x04"):
        message = f"looks like {source_file.describe_content(data)}, expected an .npz archive"
        raise FormatError(message, path=path, reason="not-what-it-says")
    try:
        return Archive(path, zipfile.ZipFile(io.BytesIO(data)))
    except BROKEN_ZIP as error:
        raise FormatError(f"broken .npz archive ({error})", path=path, reason="truncated") from None


def peek_keys(path: Path) -> frozenset[str]:
    """The names of an .npz file's arrays, empty if it has no zip directory; reads no member."""
    try:
        with zipfile.ZipFile(path) as zipped:
            return frozenset(Archive(path, zipped).keys)
    except BROKEN_ZIP:
        return frozenset()


class PickleError(ValueError):
    """A pickle that is broken or holds anything but plain data and numpy arrays."""


def read_object(path: Path, data: bytes, name: str = "") -> Any:
    """The content of a .npy file: an array, or the plain data that was saved as a Python object; one value is itself.

    Raises `FormatError` as `parse_npy` does, and for a pickle that is not read (`pickle`).
    """
    try:
        _, _, dtype, start = _header(data)
        value = parse_pickle(data[start:]) if dtype.hasobject else None
    except PickleError as error:
        raise FormatError(f"a pickle that is not read: {error}", path=path, reason="pickle") from None
    except ValueError:  # a broken header, which `parse_npy` explains
        value = None
    if value is None:
        value = parse_npy(path, data, None, NUMBERS + STRINGS, name)
    return value.item() if isinstance(value, np.ndarray) and value.size == 1 else value


def parse_pickle(content: bytes) -> Any:
    """The plain data in a pickle; raises `PickleError`."""
    try:
        return _Unpickler(io.BytesIO(content), encoding="latin1").load()
    except PickleError:
        raise
    except Exception as error:  # a damaged program fails in many ways
        raise PickleError(f"broken ({type(error).__name__}: {error})"[:120]) from None


# numpy's own `dtype.__setstate__` and `ndarray.__setstate__` trust their arguments, up to addresses in memory.


class _DType:
    def __init__(self, code: Any) -> None:
        if not re.fullmatch(r"f[248]|[iu][1248]|b1|[US][1-9]\d{0,5}|O8", code):
            raise PickleError("an array of records or of an unknown type")
        self.dtype = np.dtype(code)

    def __setstate__(self, state: Any) -> None:
        self.dtype = self.dtype.newbyteorder(">" if state[1] == ">" else "<")

    def check(self, content: object, shape: tuple[int, ...]) -> None:
        size = math.prod(shape) * (1 if self.dtype.hasobject else self.dtype.itemsize)
        expected = list if self.dtype.hasobject else bytes
        if min(shape, default=0) < 0 or not isinstance(content, expected) or len(content) != size:
            raise PickleError(f"an array of shape {shape} whose content is not {size} long"[:120])

    def value(self, content: bytes) -> Any:
        self.check(content, ())
        return np.frombuffer(content, self.dtype).item()


class _Array(np.ndarray):
    def __setstate__(self, state: Any) -> None:
        _, shape, kind, column_major, content = state
        kind.check(content, shape)
        super().__setstate__((1, shape, kind.dtype, column_major, content))


class _Unpickler(pickle._Unpickler):  # the one in Python: in C, a memo's index can take all memory
    constructors: ClassVar[dict[str, Any]] = {
        "numpy._core.multiarray._reconstruct": lambda *arguments: np.ndarray.__new__(_Array, 0),
        "numpy._core.multiarray.scalar": lambda kind, content: kind.value(content),
        "numpy.ndarray": None,  # an argument of _reconstruct
        "numpy.dtype": lambda code, *options: _DType(code),
        "_codecs.encode": lambda text, encoding: str.encode(text, "latin1"),  # the encoding of numpy's bytes
    }
    dispatch: ClassVar[dict[int, Any]] = {**pickle._Unpickler.dispatch}
    del dispatch[pickle.BYTEARRAY8[0]]  # which allocates before it reads; numpy writes protocol 4

    def find_class(self, module: str, name: str) -> Any:
        called = f"{module}.{name}"[:80].replace("numpy.core.", "numpy._core.")  # as numpy 1 has it
        if called not in self.constructors:
            raise PickleError(f"it calls for {called!r}, which would be code to run")
        return self.constructors[called]
