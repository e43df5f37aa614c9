"""Combines SQL conditions, and runs SQL over Arrow tables with duckdb, without access to files."""

import atexit
import os
from collections import Counter
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache
from typing import TYPE_CHECKING, Any

from motionkit.core.errors import UsageError

if TYPE_CHECKING:
    import duckdb
    import pyarrow as pa

# Arrow tables and datasets.
Views = Mapping[str, Any]
# How long to wait before interrupting duckdb again: between two statements it forgets an interrupt.
INTERRUPT_SECONDS = 0.05


def query(views: Views, sql: str) -> "pa.Table":
    """Result of one SQL statement over the views as an Arrow table; a name that comes again gets _1, _2 …

    The statement can neither read nor write files, and what it creates is gone when it ends. Raises `UsageError` for
    anything but one reading statement, and with duckdb's words where it cannot run. Ctrl-C stops a statement that runs.
    """
    with _database(os.getpid()).cursor() as connection, ThreadPoolExecutor(1, "query") as thread:
        # Within duckdb, Ctrl-C would be ignored until the statement ends, or become an error of the statement.
        running = thread.submit(_query, connection, views, sql)
        try:
            return running.result()
        except KeyboardInterrupt:
            while not running.done():
                connection.interrupt()
                wait([running], INTERRUPT_SECONDS)
            raise


@cache
def _database(process: int) -> "duckdb.DuckDBPyConnection":
    """The empty database of a process, in memory, without access to files; a forked process cannot use its parent's."""
    import duckdb

    database = duckdb.connect()
    # The temporary directory is excepted from enable_external_access.
    database.execute("SET temp_directory = ''; SET enable_external_access = false; SET lock_configuration = true")
    atexit.register(_database.cache_clear)  # else duckdb's library reports a leak
    return database


def _query(connection: "duckdb.DuckDBPyConnection", views: Views, sql: str) -> "pa.Table":
    import duckdb

    connection.begin()
    try:
        for name, view in views.items():
            connection.register(name, view)
        kinds = [statement.type for statement in connection.extract_statements(sql)]
        if len(kinds) != 1 or kinds[0] not in (duckdb.StatementType.SELECT, duckdb.StatementType.EXPLAIN):
            raise UsageError("one statement that only reads is expected: SELECT, FROM, WITH, DESCRIBE, SUMMARIZE …")
        return _with_unique_names(connection.sql(sql).to_arrow_table())
    except duckdb.Error as error:
        tables = ""
        if isinstance(error, duckdb.CatalogException):  # what duckdb suggests are tables of its own
            tables = " (the tables of a store are sequences, motions and skeletons)"
        raise UsageError(f"duckdb: {' '.join(str(error).split())}{tables}") from None
    finally:
        connection.rollback()


def _with_unique_names(table: "pa.Table") -> "pa.Table":
    # SELECT * over a join repeats names, and whoever reads columns by name would see one of them twice.
    counts: Counter[str] = Counter()
    names = []
    for name in table.column_names:
        names.append(f"{name}_{counts[name]}" if counts[name] else name)
        counts[name] += 1
    return table.rename_columns(names)


def conjunction(*conditions: str | None) -> str:
    """Combines conditions with AND, skipping None and empty ones; empty if there is none."""
    given = [condition for condition in conditions if condition]
    return given[0] if len(given) == 1 else " AND ".join(f"({condition})" for condition in given)
