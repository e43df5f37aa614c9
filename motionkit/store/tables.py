"""The store's small tables, out of the bytes that their checksums were taken of."""

import pyarrow as pa
import pyarrow.parquet as pq


def read_table(content: bytes) -> pa.Table:
    """The table of a Parquet file's content; raises what pyarrow raises.

    One thread reads it. Arrow's own threads would keep the content for some milliseconds after the call, and where one
    of them lets go of a Python object while the interpreter ends, the process aborts: "terminate called without an
    active exception" (apache/arrow issues 36389 and 49942). One thread is quicker for such tables, too.
    """
    return pq.ParquetFile(pa.BufferReader(content)).read(use_threads=False)
