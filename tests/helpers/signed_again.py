"""Stores that somebody changed and signed again: every checksum agrees with what is wrong."""

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from motionkit.store.commit import finished_entry

Edit = Callable[[pa.Table], pa.Table]


def sign(store: Path, edit: Callable[[dict[str, Any]], None]) -> None:
    """Change the manifest's document."""
    path = store / "manifest.json"
    document = json.loads(path.read_text())
    edit(document)
    path.write_text(json.dumps(document, indent=2))


def rewrite(store: Path, name: str, edit: Edit) -> None:
    """Change a file's rows and make the manifest agree."""
    table = edit(pq.read_table(store / name))
    pq.write_table(table, store / name)
    describe(store, name, table.num_rows)


def describe(store: Path, name: str, num_rows: int) -> None:
    """Make the manifest say what a file is now."""
    entry = asdict(finished_entry(store / name, num_rows))
    sign(store, lambda document: document["files"].update({name: entry}))


def with_column(name: str, change: Callable[[pa.ChunkedArray], object]) -> Edit:
    def edit(table: pa.Table) -> pa.Table:
        index = table.schema.get_field_index(name)
        field = table.schema.field(index)
        return table.set_column(index, field, pa.array(change(table[name]), type=field.type))

    return edit


def with_value(name: str, row: int, value: object) -> Edit:
    def change(column: pa.ChunkedArray) -> list[object]:
        values = column.to_pylist()
        values[row] = value
        return values

    return with_column(name, change)


def with_number(name: str, row: int, number: float) -> Edit:
    def change(column: pa.ChunkedArray) -> list[object]:
        values = column.to_pylist()
        values[row][5] = number
        return values

    return with_column(name, change)


def with_broken_text(name: str) -> Edit:
    def edit(table: pa.Table) -> pa.Table:
        index = table.schema.get_field_index(name)
        texts = pa.StringArray.from_buffers(1, pa.py_buffer(b"\0\0\0\0\2\0\0\0"), pa.py_buffer(b"\xff\xfe"))
        return table.slice(0, 1).set_column(index, table.schema.field(index), texts)

    return edit
