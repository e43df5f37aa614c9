"""Tables out of bytes: nobody keeps the bytes when the call is over, or a script that ends just then is aborted."""

import re
import sys
from pathlib import Path

import pyarrow.parquet as pq

from motionkit.store.reader import Store, read_table


def test_no_thread_keeps_the_content_after_the_call(small_store: Path) -> None:
    content = (small_store / "sequences.parquet").read_bytes()
    before = sys.getrefcount(content)
    # pyarrow's read_table leaves it to its threads in most calls, for milliseconds.
    assert [sys.getrefcount(content) - before for _ in range(200) if read_table(content).num_rows] == [0] * 200


def test_the_table_is_the_files(small_store: Path) -> None:
    for name in ("sequences.parquet", "skeletons.parquet"):
        table = read_table((small_store / name).read_bytes())
        expected = pq.read_table(small_store / name)
        assert table.equals(expected) and table.schema.equals(expected.schema, check_metadata=True)


def test_a_notebook_shows_what_a_store_holds(small_store: Path) -> None:
    odd = small_store.rename(small_store.with_name("<b>store"))
    shown = Store.open(odd)._repr_html_()
    assert "&lt;b&gt;store" in shown and "<b>" not in shown
    counts = re.findall(r"<td>([^<]*)</td>", shown)[3::5]
    assert sum(map(int, counts)) == len(Store.open(odd)) > 0
