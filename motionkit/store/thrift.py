"""Thrift's compact protocol, in which Parquet writes its headers and footers: values → bytes.

Source: https://github.com/apache/thrift/blob/master/doc/specs/thrift-compact-protocol.md
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

_I8, _I32, _I64, _BINARY, _LIST, _STRUCT = 3, 5, 6, 8, 9, 12
_TRUE, _FALSE = 1, 2
_SHORT = 15


class Value(NamedTuple):
    """A value as it is written; `kind` is its type's number in the protocol."""

    kind: int
    content: bytes


def varint(number: int) -> bytes:
    """A number ≥ 0, seven bits a byte, the lowest first (ULEB128)."""
    content = bytearray()
    while number > 0x7F:
        content.append(number & 0x7F | 0x80)
        number >>= 7
    content.append(number)
    return bytes(content)


def i8(number: int) -> Value:
    """An integer of 8 bits."""
    return Value(_I8, number.to_bytes(1, "little", signed=True))


def i32(number: int) -> Value:
    """An integer of 32 bits."""
    return Value(_I32, varint(_zigzag(number)))


def i64(number: int) -> Value:
    """An integer of 64 bits."""
    return Value(_I64, varint(_zigzag(number)))


def boolean(truth: bool) -> Value:
    """A truth value, as a field of a struct."""
    return Value(_TRUE if truth else _FALSE, b"")


def binary(content: bytes) -> Value:
    """Bytes, or a text as UTF-8."""
    return Value(_BINARY, varint(len(content)) + content)


def list_of(values: Sequence[Value]) -> Value:
    """A list of at least one value, all of one type."""
    (kind,) = {value.kind for value in values}
    head = bytes([len(values) << 4 | kind]) if len(values) < _SHORT else bytes([0xF0 | kind]) + varint(len(values))
    return Value(_LIST, head + b"".join(value.content for value in values))


def struct(fields: Mapping[int, Value]) -> Value:
    """A struct; `fields` by their numbers, which ascend by 15 at most."""
    content, before = bytearray(), 0
    for number, value in fields.items():
        assert 0 < number - before <= _SHORT
        content.append((number - before) << 4 | value.kind)
        content += value.content
        before = number
    content.append(0)
    return Value(_STRUCT, bytes(content))


def _zigzag(number: int) -> int:
    return number << 1 if number >= 0 else (-number << 1) - 1
