"""What all readers share: a file's bytes, the framerate in use, tables of numbers."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from motionkit.io.bvh import read_bvh
from motionkit.io.npz import read_npz
from motionkit.io.registry import ReadOptions
from motionkit.io.source_file import read_bytes, read_table
from tests.helpers.format_samples import bvh_text
from tests.helpers.refusal import refusal


@pytest.mark.parametrize("content", [b"", b" \t\r\n\0" * 70_000])
def test_a_file_of_blanks_is_empty(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.bvh"
    path.write_bytes(content)
    assert refusal(read_bytes, path).reason == "empty"


@pytest.mark.parametrize("stated", ["-1", "nan", "1e-9", "1e9", "never"])
def test_an_unusable_framerate_is_none_where_one_is_given(tmp_path: Path, stated: str) -> None:
    options = ReadOptions(fps=Fraction(25))
    walk = tmp_path / "walk.bvh"
    walk.write_text(bvh_text(frame_time=stated))
    array = tmp_path / "walk.npz"
    # 1e-9 s between frames are as many frames a second as nobody has, and so are 1e9 frames a second.
    np.savez(array, joint_positions=np.zeros((2, 22, 3), np.float32), fps=np.array(stated))
    for motion in (read_bvh(walk, options), read_npz(array, options)):
        assert motion.fps == 25
    for read, path in ((read_bvh, walk), (read_npz, array)):
        assert refusal(read, path).reason == "frame-time"


NUMBERS = st.one_of(
    st.floats(-1e8, 1e8).map(repr),
    st.floats(-1e3, 1e3).map(lambda value: f"{value:.4f}"),
    st.sampled_from(["0", "-0", ".5", "5.", "1e-300", "-2.20695e-032", "3.64024e-015", "+7"]),
)
SEPARATORS = st.sampled_from([" ", "  ", "\t", " \t"])
LINE_ENDS = st.sampled_from(["\n", " \n", "\r\n", "\n\n", "\n ", " \n\t"])


@given(st.data(), st.integers(1, 6), st.integers(1, 5))
def test_any_regular_table_is_read_as_python_reads_it(data: st.DataObject, rows: int, columns: int) -> None:
    words = [[data.draw(NUMBERS) for _ in range(columns)] for _ in range(rows)]
    text = "".join(data.draw(SEPARATORS).join(row) + data.draw(LINE_ENDS) for row in words)
    table = read_table(text.encode(), rows, columns, Path("t"), 1)
    assert np.array_equal(table, np.array(words, dtype=np.float64))
