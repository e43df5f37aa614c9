from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from motionkit.io import source_file
from motionkit.io.source_file import format_table, read_table

NUMBERS = st.one_of(
    st.floats(-1e8, 1e8).map(repr),
    st.floats(-1e3, 1e3).map(lambda value: f"{value:.4f}"),
    st.sampled_from(["0", "-0", ".5", "5.", "1e-300", "-2.20695e-032", "3.64024e-015", "+7"]),
)
SEPARATORS = st.sampled_from([" ", "  ", "\t", " \t"])
LINE_ENDS = st.sampled_from(["\n", " \n", "\r\n", "\n\n", "\n ", " \n\t"])


def table_of(text: bytes, num_rows: int, num_columns: int) -> np.ndarray:
    """The numbers of a text that is all of a table."""
    return read_table(text, num_rows, num_columns, Path("t"), 1)


@given(st.data(), st.integers(1, 6), st.integers(1, 5))
def test_any_regular_table_is_read_as_python_reads_it(data: st.DataObject, rows: int, columns: int) -> None:
    words = [[data.draw(NUMBERS) for _ in range(columns)] for _ in range(rows)]
    text = "".join(data.draw(SEPARATORS).join(row) + data.draw(LINE_ENDS) for row in words)
    table = table_of(text.encode(), rows, columns)
    assert np.array_equal(table, np.array(words, dtype=np.float64))


def test_a_table_of_thousands_of_rows() -> None:
    table = np.random.default_rng(0).normal(size=(4000, 12)).round(6)
    text = format_table(table)
    assert len(text) > 3 * source_file.BLOCK_BYTES
    assert np.array_equal(table_of(text, 4000, 12), table)


def test_written_numbers_keep_every_digit() -> None:
    table = np.array([[0.1, -1 / 3, 1e-17], [123456.789, 0.0, 2.0]])
    text = format_table(table)
    assert np.array_equal(table_of(text, 2, 3), table)
