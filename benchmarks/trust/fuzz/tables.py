"""Mutations of Parquet files: columns of another type, extreme cells, rows lost or duplicated, damaged bytes."""

import io
from random import Random
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks.trust.fuzz.binary import mutate_bytes

WILD_FLOATS = (float("nan"), float("inf"), -float("inf"), 0.0, -1.0, 1e300, 1e-300, 1e10)
WILD_INTEGERS = (0, 1, -1, 2, 127, 32_767, -32_768, 2**31 - 1, -(2**31), 2**63 - 1, -(2**63))
WILD_TEXTS = ("", "\0", "x" * 70_000, "\x1b[31m", "../../x", "nan", "{", "[1]", "1/0", "30000/1001", "😀")
TYPES = (pa.string(), pa.int64(), pa.float64(), pa.int8(), pa.binary(), pa.list_(pa.float32()), pa.null(), pa.bool_())


def mutate_parquet(rng: Random, content: bytes) -> bytes:
    """A Parquet file after one mutation of its bytes or of its table."""
    if rng.random() < 0.35:
        return mutate_bytes(rng, content)
    try:
        table = pq.read_table(io.BytesIO(content), use_threads=False)
        return _written(mutate_table(rng, table))
    except (pa.ArrowException, OSError, ValueError, TypeError, OverflowError, KeyError, UnicodeError):
        return mutate_bytes(rng, content)


def mutate_table(rng: Random, table: pa.Table) -> pa.Table:
    """A table after one mutation; raises pyarrow's errors if it is not possible."""
    name = rng.choice(table.column_names)
    place = table.column_names.index(name)
    fate = rng.randrange(12)
    if fate < 6 and table.num_rows:
        return _with_cell(rng, table, place)
    if fate == 6:
        return table.drop_columns([name])
    if fate == 7:
        names = [rng.choice(("x", "", name.upper())) if each == name else each for each in table.column_names]
        return table.rename_columns(names)
    if fate == 8:
        return table.set_column(place, name, pa.nulls(table.num_rows, rng.choice(TYPES)))
    if fate == 9:
        rows = [rng.randrange(table.num_rows) for _ in range(table.num_rows)] if table.num_rows else []
        return table.take(pa.array(rows, pa.int64()))
    if fate == 10:
        return table.slice(0, rng.randint(0, table.num_rows))
    return pa.concat_tables([table] * rng.choice((2, 3)))


def _with_cell(rng: Random, table: pa.Table, place: int) -> pa.Table:
    field = table.schema.field(place)
    values = table.column(place).to_pylist()
    row = rng.randrange(len(values))
    values[row] = _wild(rng, values[row])
    # The schema allows no nulls: a file can violate it, a table in memory cannot.
    array = pa.array(values, field.type)
    return table.set_column(place, pa.field(field.name, field.type, metadata=field.metadata), array)


def _wild(rng: Random, value: Any) -> Any:
    if rng.random() < 0.15:
        return None
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return rng.choice((*WILD_INTEGERS, value + 1, value - 1, -value))
    if isinstance(value, float):
        return rng.choice((*WILD_FLOATS, value * 2, -value))
    if isinstance(value, str):
        return rng.choice((*WILD_TEXTS, value + "x", value[:-1], value.upper()))
    if isinstance(value, bytes):
        return rng.choice((b"", value[:-1], b"\xff" * 9))
    if isinstance(value, dict):
        return {key: _wild(rng, each) if rng.random() < 0.4 else each for key, each in value.items()}
    if isinstance(value, list):
        fate = rng.randrange(5)
        if fate == 0 or not value:
            return []
        if fate == 1:
            return value[:-1]
        if fate == 2:
            return value + value
        changed = list(value)
        changed[rng.randrange(len(value))] = _wild(rng, changed[rng.randrange(len(value))])
        return changed
    return rng.choice((1.0, 0, "x"))


def _written(table: pa.Table) -> bytes:
    file = io.BytesIO()
    pq.write_table(table, file, compression="zstd")
    return file.getvalue()
