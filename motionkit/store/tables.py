"""The store's small tables, out of the bytes that their checksums were taken of."""

from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from motionkit.errors import StoreError
from motionkit.store.manifest import Manifest, read_committed
from motionkit.store.schema import FORMAT_VERSION
from motionkit.store.versions import table_schema, upgraded


def read_table(content: bytes, columns: Sequence[str] | None = None) -> pa.Table:
    """The table of a Parquet file's content, or some columns of it; raises what pyarrow raises.

    One thread reads it. Arrow's own threads would keep the content for some milliseconds after the call, and where one
    of them lets go of a Python object while the interpreter ends, the process aborts: "terminate called without an
    active exception" (apache/arrow issues 36389 and 49942). One thread is quicker for such tables, too.
    """
    return pq.ParquetFile(pa.BufferReader(content)).read(columns=columns, use_threads=False)


def open_table(store: Path, manifest: Manifest, name: str, columns: Sequence[str] | None = None) -> pa.Table | None:
    """A table as the manifest names it; None where no file is that one, as after a commit that came in between.

    Raises `StoreError` where its rows or columns are not what they should be.
    """
    try:
        return read_committed_table(store, manifest, name, columns)
    except ValueError as error:
        raise StoreError(
            f"{store / name} is damaged ({error}): restore the store from a copy, or ingest the sources into a new one"
        ) from None


def read_committed_table(
    store: Path, manifest: Manifest, name: str, columns: Sequence[str] | None = None
) -> pa.Table | None:
    """A table as the manifest names it, with the columns of the present version; None where no file is that one.

    Raises `ValueError` for a table with other columns or another number of rows than it should have, and for what is
    no Parquet.
    """
    entry = manifest.files.get(name)
    if entry is None:
        raise ValueError("the manifest does not name it")
    content = read_committed(store, name, entry)
    if content is None:
        return None
    try:
        found = pq.read_schema(pa.BufferReader(content))
        table = read_table(content, columns)
        table.validate(full=True)  # texts that are no UTF-8, lists that leave their values
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise ValueError(f"it cannot be read as Parquet ({' '.join(str(error).split())})") from None
    if not found.equals(table_schema(name, manifest.format_version)):
        raise ValueError("its columns are not those of this format version")
    if table.num_rows != entry.num_rows:
        raise ValueError(f"it has {table.num_rows} rows, the manifest says {entry.num_rows}")
    return upgraded(table, name) if columns is None and manifest.format_version != FORMAT_VERSION else table


def not_committed(store: Path) -> StoreError:
    """What to raise where `read_committed_table` finds none, however often it is asked."""
    return StoreError(
        f"the tables of the store {store} are not those that its manifest names: "
        f"'motionkit validate --store {store}' says which; restore them from a copy or ingest again"
    )
