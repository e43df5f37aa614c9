"""Plain data in pickles that numpy wrote: numbers, texts, lists, dictionaries, arrays of numbers or texts.

`np.save(path, {"motion": …, "text": […]})` writes a pickle; many systems publish their samples this way, Guo his lists
of words, and AMASS has a `gender` like this. A pickle is a program that calls what it names. Here the few names that
numpy writes stand for functions of this module, which build arrays whose sizes they have checked, and any other name is
refused. Source: numpy's `ndarray.__reduce__` and `dtype.__reduce__`, of which `__setstate__` trusts its arguments.
"""

import io
import math
import pickle
import re
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from motionkit.core.errors import FormatError

CODES = re.compile(r"f[248]|[iu][1248]|b1|[US][1-9]\d{0,5}|O8")


class PickleError(ValueError):
    """A pickle that is broken or holds anything but plain data and numpy arrays."""


def read_pickled_dict(path: Path, content: bytes) -> dict[str, Any]:
    """The dictionary in the pickle of a .npy file of one Python object: arrays, lists, texts and numbers by name.

    Raises `FormatError` (`pickle`) if the object is not a dictionary of plain data.
    """
    try:
        found = _single(parse_pickle(content))
    except PickleError as error:
        raise FormatError(f"a pickle that is not read: {error}", path=path, reason="pickle") from None
    if not isinstance(found, dict) or not all(isinstance(key, str) for key in found):
        raise FormatError("a pickle that is no dictionary of named arrays", path=path, reason="pickle")
    return found


def parse_scalar(content: bytes) -> str | int | float | None:
    """The text or number in the pickle of an object array of size 1; None for anything else."""
    try:
        value = _single(parse_pickle(content))
    except PickleError:
        return None
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return value if isinstance(value, (str, int, float)) else None


def _single(value: Any) -> Any:
    return value.item() if isinstance(value, np.ndarray) and value.size == 1 else value


def parse_pickle(content: bytes) -> Any:
    """The data in a pickle; raises `PickleError`."""
    try:
        return _Unpickler(io.BytesIO(content), encoding="latin1").load()
    except PickleError:
        raise
    except Exception as error:  # a damaged program fails in many ways
        raise PickleError(f"broken ({type(error).__name__}: {error})"[:120]) from None


# A pickle calls these with whatever it likes, hence `object`.


class _Type:
    """A dtype, without numpy's `__setstate__`."""

    def __init__(self, code: object, *options: object) -> None:
        if not isinstance(code, str) or not CODES.fullmatch(code):
            raise PickleError("an array of records or of an unknown type")
        self.dtype = np.dtype(code)

    def __setstate__(self, state: Any) -> None:
        self.dtype = self.dtype.newbyteorder(">" if state[1] == ">" else "<")


class _Array(np.ndarray):
    """An array that compares the size of its content with its shape."""

    def __setstate__(self, state: Any) -> None:
        _, shape, kind, column_major, content = state
        if not isinstance(kind, _Type) or min(shape, default=0) < 0:
            raise PickleError("an array without a type or a shape")
        _check_size(content, kind, math.prod(shape))
        super().__setstate__((1, shape, kind.dtype, column_major, content))


def _check_size(content: object, kind: Any, count: int) -> None:
    expected, size = (list, count) if kind.dtype.hasobject else (bytes, count * kind.dtype.itemsize)
    if not isinstance(content, expected) or len(content) != size:
        raise PickleError(f"an array of {count} values whose content is not {size} long")


def _empty(*arguments: object) -> _Array:
    return np.ndarray.__new__(_Array, 0)


def _scalar(kind: Any, content: Any) -> Any:
    _check_size(content, kind, 1)
    return np.frombuffer(content, kind.dtype).item()


def _encode(text: Any, encoding: object) -> bytes:
    if encoding != "latin1":
        raise PickleError("bytes in another encoding than numpy's")
    return str.encode(text, "latin1")


# Python's own names are those of numpy 2; numpy 1 has core for _core.
NAMES: dict[tuple[str, str], Any] = {
    ("numpy._core.multiarray", "_reconstruct"): _empty,
    ("numpy._core.multiarray", "scalar"): _scalar,
    ("numpy", "ndarray"): None,  # an argument of _reconstruct
    ("numpy", "dtype"): _Type,
    ("_codecs", "encode"): _encode,
}


class _Unpickler(pickle._Unpickler):
    # The one in Python: in C, the index of a memo can be made to take all memory.

    stack: list[Any]

    def find_class(self, module: str, name: str) -> Any:
        key = (module.replace("numpy.core.", "numpy._core."), name)
        if key not in NAMES:
            raise PickleError(f"it calls for {f'{module}.{name}'[:80]!r}, which would be code to run")
        return NAMES[key]

    def load_build(self) -> None:
        if not isinstance(self.stack[-2], (_Type, _Array)):
            raise PickleError("it sets the state of an object")
        super().load_build()  # type: ignore[misc]

    dispatch: ClassVar[dict[int, Any]] = {**pickle._Unpickler.dispatch, pickle.BUILD[0]: load_build}
    del dispatch[pickle.BYTEARRAY8[0]]  # which allocates before it reads; numpy writes protocol 4
