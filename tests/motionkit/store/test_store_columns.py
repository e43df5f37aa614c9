"""Python values → Arrow: the same as pyarrow's own way, which imports pandas."""

from typing import Any

import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motionkit.store.codec import array_of, table_of
from motionkit.store.schema import SEQUENCES, SKELETONS


def values_of(kind: pa.DataType, *, nullable: bool) -> st.SearchStrategy[Any]:
    if pa.types.is_struct(kind):
        some: st.SearchStrategy[Any] = st.fixed_dictionaries(
            {field.name: values_of(field.type, nullable=field.nullable) for field in kind}
        )
    elif pa.types.is_list(kind):
        some = st.lists(values_of(kind.value_type, nullable=False), max_size=3)
    elif pa.types.is_string(kind):
        some = st.text(max_size=5)
    elif pa.types.is_boolean(kind):
        some = st.booleans()
    elif pa.types.is_floating(kind):
        some = st.floats(width=kind.bit_width)
    else:
        some = st.integers(-(2 ** (kind.bit_width - 1)), 2 ** (kind.bit_width - 1) - 1)
    return st.none() | some if nullable else some


def rows_of(schema: pa.Schema) -> st.SearchStrategy[list[dict[str, Any]]]:
    row = {field.name: values_of(field.type, nullable=field.nullable) for field in schema}
    return st.lists(st.fixed_dictionaries(row), max_size=12)


KINDS = {field.type: field for schema in (SEQUENCES, SKELETONS) for field in schema}
EVERY_KIND = pa.schema(
    [pa.field(str(number), *each) for number, each in enumerate((k, n) for k in KINDS for n in (0, 1))]
)


@given(rows_of(EVERY_KIND))
@settings(max_examples=40)
def test_tables_are_pyarrows(rows: list[dict[str, Any]]) -> None:
    table = table_of(rows, EVERY_KIND)
    table.validate(full=True)
    expected = pa.Table.from_pylist(rows, EVERY_KIND)
    assert table.schema.equals(expected.schema, check_metadata=True)
    # As JSON, where not-a-number is equal to itself.
    assert repr(table.to_pylist()) == repr(expected.to_pylist())


def test_an_integer_that_does_not_fit_is_refused() -> None:
    with pytest.raises(OverflowError):
        array_of([2**31], pa.int32())
