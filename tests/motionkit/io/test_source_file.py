"""What all readers share: a file's bytes, the framerate in use, tables of numbers."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from motionkit.core.errors import FormatError
from motionkit.io.bvh import read_bvh
from motionkit.io.npz import read_npz
from motionkit.io.registry import ReadOptions
from motionkit.io.source_file import BLOCK_BYTES, format_table, fps_in_use, read_bytes, read_table, replaced_fps
from tests.helpers.format_samples import bvh_text


@pytest.mark.parametrize("content", [b"", b" \t\r\n\0" * 70_000])
def test_a_file_of_blanks_is_empty(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.bvh"
    path.write_bytes(content)
    with pytest.raises(FormatError) as caught:
        read_bytes(path)
    assert caught.value.reason == "empty"


def unusable() -> Fraction:
    raise FormatError("no usable clock", path="a.bvh", reason="frame-time")


def test_what_is_given_goes_before_what_is_stated_and_the_log_says_so() -> None:
    assert fps_in_use(None, lambda: Fraction(30)) == (30, [])
    assert fps_in_use(Fraction(30), lambda: Fraction(30)) == (30, [])
    assert fps_in_use(Fraction(24), lambda: Fraction(30)) == (24, ["framerate set to 24; the file says 30"])
    assert fps_in_use(Fraction(24), unusable) == (24, ["framerate set to 24; the file says none"])
    assert fps_in_use(Fraction(24), unusable, words="9 a day")[1] == ["framerate set to 24; the file says 9 a day"]
    with pytest.raises(FormatError, match="no usable clock"):
        fps_in_use(None, unusable)
    replaced = replaced_fps(Fraction(24), Fraction(30), who="the data set")
    assert replaced == ["framerate set to 24; the data set says 30"]


@pytest.mark.parametrize("stated", ["0", "-1", "nan", "inf", "1e-9", "1e9", "never"])
def test_an_unusable_framerate_is_none_where_one_is_given(tmp_path: Path, stated: str) -> None:
    options = ReadOptions(fps=Fraction(25))
    walk = tmp_path / "walk.bvh"
    walk.write_text(bvh_text(frame_time=stated))
    array = tmp_path / "walk.npz"
    # 1e-9 s between frames are as many frames a second as nobody has, and so are 1e9 frames a second.
    np.savez(array, joint_positions=np.zeros((2, 22, 3), np.float32), fps=np.array(stated))
    for motion in (read_bvh(walk, options), read_npz(array, options)):
        assert motion.fps == 25
        assert motion.provenance.operations[0] == "framerate set to 25; the file says none"
    for read, path in ((read_bvh, walk), (read_npz, array)):
        with pytest.raises(FormatError) as caught:
            read(path)
        assert caught.value.reason == "frame-time"


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


def test_written_numbers_of_thousands_of_rows_keep_every_digit() -> None:
    table = np.random.default_rng(0).normal(size=(4000, 12))
    table[7, :5] = -1 / 3, 1e-17, 123456.789, 0.0, 2.0
    text = format_table(table)
    assert len(text) > 3 * BLOCK_BYTES
    assert np.array_equal(table_of(text, 4000, 12), table)
