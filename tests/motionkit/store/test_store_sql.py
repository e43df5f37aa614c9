"""Ctrl-C stops a statement, and is no fault of it."""

import os
import signal
import threading

import pyarrow as pa
import pytest

from motionkit.store.sql import query

# Minutes of work.
LONG = "SELECT count(*) FROM range(100000000) a, range(1000) b WHERE a.range * b.range % 7 = 1"


@pytest.mark.parametrize("seconds", [0.0, 0.05, 0.5])
def test_a_statement_is_stopped(seconds: float) -> None:
    query({}, "SELECT 1")  # whatever is imported late
    timer = threading.Timer(seconds, os.kill, (os.getpid(), signal.SIGINT))
    with pytest.raises(KeyboardInterrupt):
        timer.start()
        query({"sequences": pa.table({"a": [1]})}, LONG)
    timer.join()
