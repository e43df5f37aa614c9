"""Format versions: which can be read, what each added, and how an older table becomes one of the present version."""

import pyarrow as pa

from motionkit.store.schema import FORMAT_VERSION, SEQUENCES, SEQUENCES_FILE, SKELETONS, SKELETONS_FILE

READABLE_VERSIONS = (1, FORMAT_VERSION)

_SCHEMAS = {SEQUENCES_FILE: SEQUENCES, SKELETONS_FILE: SKELETONS}

_QUALITY = (
    "num_teleports",
    "first_teleport_seconds",
    "jitter_metres_per_second_cubed",
    "frozen_seconds",
    "frozen_start_seconds",
    "held_share",
    "foot_skate_metres_per_second",
    "foot_skate_share",
    "bone_length_drift",
    "effective_fps",
)

# What each version added to a table. A column that is added later needs a value that says "not known": null where it
# may be null, else the empty string or list.
_ADDED = {2: {SEQUENCES_FILE: ("style", *_QUALITY), SKELETONS_FILE: ("layout_map",)}}


def table_schema(name: str, version: int) -> pa.Schema:
    """Schema of the table `name` in a store of the format version."""
    later = {column for added_in, tables in _ADDED.items() if added_in > version for column in tables[name]}
    return pa.schema([field for field in _SCHEMAS[name] if field.name not in later])


def upgraded(table: pa.Table, name: str) -> pa.Table:
    """The table `name` with the columns of the present version; what an older one does not hold is not known.

    Raises `KeyError` where a column is missing that every version has.
    """
    schema = _SCHEMAS[name]
    added = {column for tables in _ADDED.values() for column in tables[name]}
    columns = [
        _not_known(field, table.num_rows)
        if field.name in added and field.name not in table.column_names
        else table[field.name]
        for field in schema
    ]
    return pa.Table.from_arrays(columns, schema=schema)


def _not_known(field: pa.Field, num_rows: int) -> pa.Array:
    if field.nullable:
        return pa.nulls(num_rows, field.type)
    return pa.array(["" if pa.types.is_string(field.type) else []] * num_rows, field.type)
