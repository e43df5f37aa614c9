"""A statement cannot touch files or later statements; Ctrl-C stops it, and is no fault of it."""

import os
import signal
import threading
from pathlib import Path

import pyarrow as pa
import pytest

from motionkit.core.errors import UsageError
from motionkit.store.reader import query

# Minutes of work.
LONG = "SELECT count(*) FROM range(100000000) a, range(1000) b WHERE a.range * b.range % 7 = 1"


def test_a_statement_is_stopped() -> None:
    query({"sequences": pa.table({"a": [1]})}, "SELECT 1")  # whatever is imported late
    timer = threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT))
    with pytest.raises(KeyboardInterrupt):
        timer.start()
        query({"sequences": pa.table({"a": [1]})}, LONG)
    timer.join()


@pytest.mark.parametrize(
    "sql",
    [
        "EXPLAIN ANALYZE COPY (SELECT 'x' AS a) TO '.tmp/new.csv'",
        "SELECT * FROM read_text('.tmp/there.csv')",
        "SELECT * FROM '.tmp/there.csv'",
    ],
)
def test_a_statement_has_no_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sql: str) -> None:
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / ".tmp"  # duckdb's own place for temporary files
    folder.mkdir()
    (folder / "there.csv").write_text("a\nx\n")
    with pytest.raises(UsageError):
        query({}, sql)
    assert [path.name for path in folder.iterdir()] == ["there.csv"]


def test_a_statement_leaves_nothing_to_the_next() -> None:
    assert query({"sequences": pa.table({"a": [1]})}, "SELECT a FROM sequences")["a"].to_pylist() == [1]
    query({}, "EXPLAIN ANALYZE CREATE TABLE sequences AS SELECT 2 AS a")
    for name in ("sequences", "skeletons"):
        with pytest.raises(UsageError, match=name):
            query({}, f"SELECT * FROM {name}")
