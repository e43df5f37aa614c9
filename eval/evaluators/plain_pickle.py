"""Lists and dictionaries of words and whole numbers out of a pickle, without unpickling.

Only the instructions with which pickle's protocols 2 to 5 build such values are understood, so nothing in the file can
import, call or construct anything: the first other instruction ends the reading.
"""

import pickletools
from pathlib import Path

LARGEST_BYTES = 64 << 20
_VALUES = {"BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8", "BININT", "BININT1", "BININT2", "LONG1"}
_REMEMBER = {"BINPUT", "LONG_BINPUT", "MEMOIZE"}
_RECALL = {"BINGET", "LONG_BINGET"}


class PlainPickleError(ValueError):
    """A file that is not the pickle of a list or dictionary of words and whole numbers."""


def read_plain_pickle(path: Path) -> list[object] | dict[object, object]:
    """The list or dictionary that a pickle file holds.

    Raises `PlainPickleError` for anything but words and whole numbers in it, for damage, and for more than 64 MiB;
    `OSError` where the file cannot be read.
    """
    if path.stat().st_size > LARGEST_BYTES:
        raise PlainPickleError(f"{path.stat().st_size:,} bytes are too many for a list of words")
    data = path.read_bytes()
    try:
        result = _interpret(data)
    except PlainPickleError:
        raise
    except (ValueError, IndexError, KeyError, TypeError, AttributeError) as error:
        raise PlainPickleError(f"not a whole pickle ({error})") from None
    if not isinstance(result, list | dict):
        raise PlainPickleError("holds neither a list nor a dictionary")
    return result


def _interpret(data: bytes) -> object:
    """Run the few instructions on a stack; a mark is the stack's height at that moment."""
    stack: list[object] = []
    marks: list[int] = []
    remembered: dict[int, object] = {}
    for operation, argument, place in pickletools.genops(data):
        name = operation.name
        if name in _VALUES:
            stack.append(argument)
        elif name in _REMEMBER:
            remembered[len(remembered) if argument is None else int(argument)] = stack[-1]
        elif name in _RECALL:
            stack.append(_plain(remembered[int(argument or 0)]))
        elif name == "EMPTY_LIST":
            stack.append([])
        elif name == "EMPTY_DICT":
            stack.append({})
        elif name == "MARK":
            marks.append(len(stack))
        elif name in ("APPEND", "APPENDS"):
            values = _above(stack, len(stack) - 1 if name == "APPEND" else marks.pop())
            container = stack[-1]
            if not isinstance(container, list):
                raise PlainPickleError("appends to what is no list")
            container.extend(values)
        elif name in ("SETITEM", "SETITEMS"):
            values = _above(stack, len(stack) - 2 if name == "SETITEM" else marks.pop())
            container = stack[-1]
            if not isinstance(container, dict):
                raise PlainPickleError("sets items of what is no dictionary")
            container.update(zip(values[::2], values[1::2], strict=True))
        elif name == "STOP":
            return stack[-1]
        elif name not in ("PROTO", "FRAME"):
            raise PlainPickleError(f"asks for {name} at byte {place}, which a list of words has no use for")
    raise PlainPickleError("ends before it is complete")


def _above(stack: list[object], height: int) -> list[object]:
    """Take what lies above a height off the stack."""
    values = [_plain(value) for value in stack[height:]]
    del stack[height:]
    return values


def _plain(value: object) -> object:
    if not isinstance(value, str | int):
        raise PlainPickleError("holds containers inside containers")
    return value
