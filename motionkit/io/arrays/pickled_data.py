"""Plain data in a pickle written by numpy, built from its opcodes: nothing is unpickled, so no code in a file can run.

`np.save(path, {"motion": …, "text": […]})` writes an array of one Python object, hence a pickle; many repositories that
generate motion publish their samples this way. The opcodes are only listed (`pickletools.genops`); a small interpreter
builds the data they describe: strings, numbers, lists, tuples, dictionaries, and numpy arrays of numbers or strings.
The calls that numpy writes are recognised by name and never made; a pickle with any other is refused. AMASS's `gender`
and Guo's lists of words are read this way. Source: numpy's `ndarray.__reduce__` and `numpy.lib.format`, pickle 2 to 5.
"""

import io
import math
import mmap
import pickletools
import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, cast

import numpy as np

from motionkit.core.errors import FormatError
from motionkit.io.arrays import npy
from motionkit.io.source import source_file

CONSTANTS = frozenset(
    (
        *("INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT"),
        *("UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8", "STRING", "BINSTRING", "SHORT_BINSTRING"),
        *("BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8"),
    )
)
FIXED: dict[str, object] = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
EMPTY: dict[str, Callable[[], object]] = {"EMPTY_LIST": list, "EMPTY_DICT": dict, "EMPTY_TUPLE": tuple}
PUTS = frozenset({"PUT", "BINPUT", "LONG_BINPUT"})
GETS = frozenset({"GET", "BINGET", "LONG_BINGET"})
TUPLE_SIZES = {"TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}
SKIPPED = frozenset({"PROTO", "FRAME"})
_CORES = ("numpy._core.multiarray", "numpy.core.multiarray")
RECONSTRUCT = frozenset(f"{core} _reconstruct" for core in _CORES)
SCALAR = frozenset(f"{core} scalar" for core in _CORES)
FROM_BUFFER = frozenset({"numpy._core.numeric _frombuffer", "numpy.core.numeric _frombuffer"})
NDARRAY, DTYPE, ENCODE = "numpy ndarray", "numpy dtype", "_codecs encode"
KNOWN = RECONSTRUCT | SCALAR | FROM_BUFFER | {NDARRAY, DTYPE, ENCODE}
MAX_DEPTH = 8
CODES = re.compile(r"f[248]|[iu][1248]|b1|[US]\d{1,6}|O8")
_MARK = object()


class PickleError(ValueError):
    """A pickle that is broken or holds anything but plain data and numpy arrays."""


@dataclass
class _Name:
    text: str


@dataclass
class _Type:
    code: str
    order: str = "|"


@dataclass
class _Array:
    """An array as its pickle describes it, filled in by BUILD."""

    shape: tuple[int, ...] | None = None
    type: _Type | None = None
    column_major: bool = False
    content: object = None


def read_pickled_dict(path: Path) -> dict[str, Any]:
    """The dictionary in a .npy file of one Python object: arrays, lists, strings and numbers by name.

    Raises `FormatError` (`pickle`) if the object is not a dictionary of plain data.
    """
    if path.stat().st_size > source_file.MAX_BYTES:
        raise FormatError("too large, expected at most 4 GB", path=path, reason="too-large")
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as mapped:
        head = io.BytesIO(mapped[: npy.HEADER_BYTES])
        try:
            shape, _, _ = npy.read_header(head)
            mapped.seek(head.tell())
            # A memory map never reads beyond the file, whatever length an opcode states.
            value = parse_pickle(mapped)
        except ValueError as error:
            raise FormatError(f"a pickle that is not read: {error}", path=path, reason="pickle") from None
    found = value[0] if math.prod(shape) == 1 and isinstance(value, list) and len(value) == 1 else value
    if not isinstance(found, dict) or not all(isinstance(key, str) for key in found):
        raise FormatError("a pickle that is no dictionary of named arrays", path=path, reason="pickle")
    return found


def is_pickled(path: Path) -> bool:
    """Whether a .npy file's header declares Python objects; reads only the header."""
    try:
        with path.open("rb") as file:
            return "O" in npy.read_header(io.BytesIO(file.read(npy.HEADER_BYTES)))[2]
    except (OSError, ValueError):
        return False


def parse_pickle(file: io.BytesIO | mmap.mmap) -> Any:
    """The data in a pickle; an array of objects becomes a list of its elements. Raises `PickleError`."""
    machine = _Machine()
    try:
        with warnings.catch_warnings(action="ignore"):  # about invalid escapes in protocol 0's strings
            for opcode, argument, _ in pickletools.genops(cast(IO[bytes], file)):
                machine.step(opcode.name, argument)
        return _finished(machine.stack.pop(), {})
    except PickleError:
        raise
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError, RecursionError) as error:
        raise PickleError(f"broken ({error})"[:120]) from None


def parse_scalar(content: bytes) -> str | int | float | None:
    """The string or number in the pickle of an object array of size 1; None for anything else."""
    try:
        value = parse_pickle(io.BytesIO(content))
    except PickleError:
        return None
    if isinstance(value, list) and len(value) == 1:
        value = value[0]
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return value if isinstance(value, (str, int, float)) else None


class _Machine:
    """The stack and memo of the pickle machine."""

    def __init__(self) -> None:
        self.stack: list[Any] = []
        self._memo: dict[int, Any] = {}

    def step(self, name: str, argument: Any) -> None:
        """Apply one opcode to the stack. Raises `PickleError` for an opcode that plain data does not need."""
        stack = self.stack
        if name in CONSTANTS:
            stack.append(argument)
        elif name in FIXED:
            stack.append(FIXED[name])
        elif name in EMPTY:
            stack.append(EMPTY[name]())
        elif name == "MARK":
            stack.append(_MARK)
        elif name in PUTS or name == "MEMOIZE":
            self._memo[len(self._memo) if name == "MEMOIZE" else int(argument)] = stack[-1]
        elif name in GETS:
            stack.append(self._memo[int(argument)])
        elif name in TUPLE_SIZES:
            stack[-TUPLE_SIZES[name] :] = [tuple(stack[-TUPLE_SIZES[name] :])]
        elif name in ("TUPLE", "LIST"):
            items = self._since_mark()
            stack.append(tuple(items) if name == "TUPLE" else items)
        elif name in ("APPEND", "APPENDS", "SETITEM", "SETITEMS"):
            self._extend(name)
        elif name == "GLOBAL":
            stack.append(_known(str(argument)))
        elif name == "STACK_GLOBAL":
            attribute, module = _text(stack.pop()), _text(stack.pop())
            stack.append(_known(f"{module} {attribute}"))
        elif name == "REDUCE":
            arguments, function = stack.pop(), stack.pop()
            stack.append(_result(function.text, arguments))
        elif name == "BUILD":
            state = stack.pop()
            _fill(stack[-1], state)
        elif name not in SKIPPED and name != "STOP":
            raise PickleError(f"it has the opcode {name}, which plain data and arrays do not need")

    def _since_mark(self) -> list[Any]:
        place = len(self.stack) - 1
        while self.stack[place] is not _MARK:
            place -= 1
            if place < 0:
                raise PickleError("broken (no mark)")
        items = self.stack[place + 1 :]
        del self.stack[place:]
        return items

    def _extend(self, name: str) -> None:
        if name.endswith("S"):
            items = self._since_mark()
        else:
            count = 1 if name == "APPEND" else 2
            items = self.stack[-count:]
            del self.stack[-count:]
        target = self.stack[-1]
        if isinstance(target, list):
            target.extend(items)
        elif isinstance(target, dict):
            target.update(zip(items[::2], items[1::2], strict=True))
        else:
            raise PickleError("broken (items for what holds none)")


def _text(value: object) -> str:
    # Nested shared lists may grow exponentially when printed.
    if not isinstance(value, str):
        raise PickleError(f"broken (a {type(value).__name__} where a text belongs)")
    return value


def _known(name: str) -> _Name:
    if name not in KNOWN:
        raise PickleError(f"it calls for {name.replace(' ', '.')[:80]!r}, which would be code to run")
    return _Name(name)


def _result(function: str, arguments: tuple[Any, ...]) -> object:
    """The result of a call that numpy writes, without making it."""
    if function in RECONSTRUCT:
        return _Array()
    if function == DTYPE:
        code = _text(arguments[0])
        if not CODES.fullmatch(code):
            raise PickleError(f"an array of {code!r}"[:80])
        return _Type(code)
    if function in FROM_BUFFER:
        content, kind, shape, order = arguments
        return _Array(shape, kind, order == "F", content)
    if function in SCALAR:
        kind, content = arguments
        return _numbers(_Array((), kind, False, content)).item()
    if function == ENCODE:
        text, encoding = map(_text, arguments)
        if encoding != "latin1":
            raise PickleError(f"bytes written as {encoding!r}"[:80])
        return text.encode("latin1")
    raise PickleError(f"it calls {function!r}")


def _fill(target: object, state: tuple[Any, ...]) -> None:
    if isinstance(target, _Type):
        _, target.order, subtype, names, *_ = state
        if subtype is not None or names is not None:
            raise PickleError("an array of records")
    elif isinstance(target, _Array):
        _, target.shape, target.type, column_major, target.content = state
        target.column_major = bool(column_major)
    else:
        raise PickleError("it sets the state of an object")


def _finished(value: Any, done: dict[int, Any], depth: int = 0) -> Any:
    """Replace descriptions of arrays by arrays, recursively; shared objects are converted once (`done`, by id)."""
    if depth > MAX_DEPTH:
        raise PickleError(f"nested more than {MAX_DEPTH} deep")
    if isinstance(value, (str, bytes, int, float)) or value is None:
        return value
    if id(value) not in done:
        if isinstance(value, _Array) and value.type is not None and value.type.code == "O8":
            result: Any = _finished(value.content, done, depth + 1)
        elif isinstance(value, _Array):
            result = _numbers(value)
        elif isinstance(value, dict):
            result = {key: _finished(item, done, depth + 1) for key, item in value.items()}
        elif isinstance(value, (list, tuple)):
            result = [_finished(item, done, depth + 1) for item in value]
        else:
            raise PickleError("it holds a type or a function")
        done[id(value)] = result
    return done[id(value)]


def _numbers(array: _Array) -> np.ndarray:
    shape, kind, content = array.shape, array.type, array.content
    if not (isinstance(shape, tuple) and isinstance(kind, _Type) and isinstance(content, (bytes, bytearray))):
        raise PickleError("broken (an array without its bytes)")
    if not all(type(size) is int and size >= 0 for size in shape) or kind.code == "O8":
        raise PickleError("broken (an array without a shape of whole numbers)")
    dtype = np.dtype(kind.code).newbyteorder(">" if kind.order == ">" else "<")
    if math.prod(shape) * dtype.itemsize != len(content):
        raise PickleError(f"an array of shape {shape} in {len(content)} bytes")
    return np.frombuffer(content, dtype).reshape(shape, order="F" if array.column_major else "C")
