"""Python values ↔ Arrow, without `pa.array`, `Table.from_pylist` and `to_numpy`: they import pandas, 0.3 seconds."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Shaped


def table_of(rows: Sequence[Mapping[str, Any]], schema: pa.Schema) -> pa.Table:
    """The table that `pa.Table.from_pylist` gives for rows which have every column of the schema."""
    columns = [array_of([row[field.name] for row in rows], field.type) for field in schema]
    return pa.Table.from_arrays(columns, schema=schema)


def array_of(values: Sequence[Any], kind: pa.DataType) -> pa.Array:
    """Numbers, truth values, texts, lists and structs of the given Arrow type; None is null.

    Raises `OverflowError` for an integer that does not fit.
    """
    present = [value is not None for value in values]
    validity = None
    if not all(present):
        validity, under_null = _bits(present), _empty(kind)
        values = [under_null if value is None else value for value in values]
    if pa.types.is_struct(kind):
        children = [array_of([value[field.name] for value in values], field.type) for field in kind]
        return pa.Array.from_buffers(kind, len(values), [validity], children=children)
    if pa.types.is_list(kind):
        elements = array_of([element for value in values for element in value], kind.value_type)
        return pa.Array.from_buffers(kind, len(values), [validity, _offsets(values)], children=[elements])
    if pa.types.is_string(kind):
        texts = [value.encode() for value in values]
        return pa.Array.from_buffers(kind, len(values), [validity, _offsets(texts), pa.py_buffer(b"".join(texts))])
    if pa.types.is_boolean(kind):
        return pa.Array.from_buffers(kind, len(values), [validity, _bits(values)])
    return _over(np.array(values, kind.to_pandas_dtype()), kind, validity)


def numbers_of(column: pa.Array | pa.ChunkedArray) -> Shaped[np.ndarray, " values"]:
    """The numbers of a column as numpy's; raises `ValueError` for nulls."""
    array = column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column
    if array.null_count:
        raise ValueError(f"{array.null_count} of {len(array)} numbers are null")
    dtype = np.dtype(array.type.to_pandas_dtype())
    if not len(array):
        return np.empty(0, dtype)
    return np.frombuffer(array.buffers()[1], dtype, len(array), array.offset * dtype.itemsize)


def _over(values: Shaped[np.ndarray, " values"], kind: pa.DataType, validity: pa.Buffer | None) -> pa.Array:
    assert values.dtype == kind.to_pandas_dtype()
    return pa.Array.from_buffers(kind, len(values), [validity, pa.py_buffer(values)])


def _offsets(values: Sequence[Sequence[Any]]) -> pa.Buffer:
    return pa.py_buffer(np.cumsum([0, *map(len, values)], dtype=np.int32))


def _bits(values: Sequence[bool]) -> pa.Buffer:
    return pa.py_buffer(np.packbits(np.array(values, bool), bitorder="little"))


def _empty(kind: pa.DataType) -> Any:
    if pa.types.is_struct(kind):
        return {field.name: _empty(field.type) for field in kind}
    if pa.types.is_list(kind):
        return []
    if pa.types.is_string(kind):
        return ""
    return False if pa.types.is_boolean(kind) else 0
