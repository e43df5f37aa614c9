"""The footer of a part: which rows and columns a Parquet file holds, and where their pages lie.

Source: https://github.com/apache/parquet-format/blob/master/src/main/thrift/parquet.thrift (FileMetaData)
"""

import base64
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from motionkit.store.pages import BYTE_STREAM_SPLIT, PLAIN, RLE
from motionkit.store.schema import FORMAT_VERSION, SEGMENTS
from motionkit.store.thrift import Value, binary, boolean, i8, i32, i64, list_of, struct

MAGIC = b"PAR1"
# The size of the metadata and the magic number.
_END_BYTES = 8

# Numbers of the format (parquet.thrift): Type, FieldRepetitionType, ConvertedType, CompressionCodec, and the fields of
# the unions LogicalType and ColumnOrder.
_INT32, _FLOAT = 1, 4
_REQUIRED, _OPTIONAL, _REPEATED = 0, 1, 2
_CONVERTED_LIST, _CONVERTED_INT_16 = 3, 16
_ZSTD = 6
_LOGICAL_LIST, _LOGICAL_INTEGER = 3, 10
_BY_TYPE = 1
_EMPTY = struct({})


@dataclass(frozen=True)
class Chunk:
    """One column of one row group: a page, from `first_byte` of the file on.

    `num_values` counts nulls too, `num_bytes_plain` with the page's body uncompressed. `bounds` are the least and the
    greatest integer of a key column.
    """

    first_byte: int
    num_bytes: int
    num_bytes_plain: int
    num_values: int
    bounds: tuple[int, int] | None = None


def row_group(chunks: Sequence[Chunk], num_rows: int) -> Value:
    """The entry of a row group; `chunks` in the order of the schema's columns."""
    columns = [_column(field, chunk) for field, chunk in zip(SEGMENTS, chunks, strict=True)]
    return struct(
        {
            1: list_of(columns),
            2: i64(sum(chunk.num_bytes_plain for chunk in chunks)),
            3: i64(num_rows),
            5: i64(chunks[0].first_byte),
            6: i64(sum(chunk.num_bytes for chunk in chunks)),
        }
    )


def footer(row_groups: Sequence[Value], num_rows: int) -> bytes:
    """What stands behind the last page of a part: its metadata, their size, the magic number."""
    arrow_schema = base64.b64encode(SEGMENTS.serialize().to_pybytes())
    content = struct(
        {
            1: i32(2),
            2: list_of([struct({3: i32(_REQUIRED), 4: binary(b"schema"), 5: i32(len(SEGMENTS))}), *_elements()]),
            3: i64(num_rows),
            4: list_of(row_groups),
            5: list_of([struct({1: binary(b"ARROW:schema"), 2: binary(arrow_schema)})]),
            # The version of the store's format, not of the program: the same frames make the same bytes.
            6: binary(f"motionkit version {FORMAT_VERSION}".encode()),
            7: list_of([struct({_BY_TYPE: _EMPTY})] * len(SEGMENTS)),
        }
    ).content
    return content + len(content).to_bytes(4, "little") + MAGIC


def read_footer(path: Path) -> bytes:
    """What stands behind the last page of a Parquet file; raises `ValueError` where there is no such thing."""
    with path.open("rb") as file:
        num_bytes = file.seek(0, os.SEEK_END)
        file.seek(max(0, num_bytes - _END_BYTES))
        end = file.read()
        length = int.from_bytes(end[:4], "little") + _END_BYTES
        if end[4:] != MAGIC or length > num_bytes:
            raise ValueError("it does not end as a Parquet file does")
        file.seek(num_bytes - length)
        return file.read()


def _elements() -> Iterator[Value]:
    for field in SEGMENTS:
        repetition = _OPTIONAL if field.nullable else _REQUIRED
        if not pa.types.is_large_list(field.type):
            yield _integer(field, repetition)
            continue
        as_list = {6: i32(_CONVERTED_LIST), 10: struct({_LOGICAL_LIST: _EMPTY})}
        yield struct({3: i32(repetition), 4: binary(field.name.encode()), 5: i32(1), **as_list})
        yield struct({3: i32(_REPEATED), 4: binary(b"list"), 5: i32(1)})
        yield struct({1: i32(_FLOAT), 3: i32(_REQUIRED), 4: binary(b"element")})


def _integer(field: pa.Field, repetition: int) -> Value:
    element = {1: i32(_INT32), 3: i32(repetition), 4: binary(field.name.encode())}
    if field.type == pa.int16():
        element[6] = i32(_CONVERTED_INT_16)
        element[10] = struct({_LOGICAL_INTEGER: struct({1: i8(16), 2: boolean(True)})})
    return struct(element)


def _column(field: pa.Field, chunk: Chunk) -> Value:
    is_list = pa.types.is_large_list(field.type)
    path = (field.name, "list", "element") if is_list else (field.name,)
    metadata = {
        1: i32(_FLOAT if is_list else _INT32),
        2: list_of([i32(RLE), i32(BYTE_STREAM_SPLIT if is_list else PLAIN)]),
        3: list_of([binary(name.encode()) for name in path]),
        4: i32(_ZSTD),
        5: i64(chunk.num_values),
        6: i64(chunk.num_bytes_plain),
        7: i64(chunk.num_bytes),
        9: i64(chunk.first_byte),
    }
    if chunk.bounds is not None:
        least, greatest = (binary(bound.to_bytes(4, "little", signed=True)) for bound in chunk.bounds)
        metadata[12] = struct({3: i64(0), 5: greatest, 6: least})
    return struct({2: i64(0), 3: struct(metadata)})
