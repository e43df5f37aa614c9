"""Rows read from a file are those of the array, in any order, and nothing of the file stays in the process."""

import copy
import os
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from motionkit.core import checksums
from motionkit.core.checksums import FileDigest, file_fault, sha256_of
from motionkit.core.errors import DamagedFileError, StoreError
from motionkit.store.cache.row_file import RowFile, write_rows

ARRAY = np.random.default_rng(0).standard_normal((50, 4, 3)).astype(np.float32)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("rows") / "rows.npy"
    np.save(path, ARRAY)
    return path


@given(
    rows=hnp.arrays(
        np.int64, hnp.array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=6), elements=st.integers(0, 49)
    )
)
def test_rows_are_those_of_the_array(path, rows):
    found = RowFile.open(path)[rows]
    np.testing.assert_array_equal(found, ARRAY[rows])
    assert found.dtype == np.float32 and found.flags.writeable and found.shape == (*rows.shape, 4, 3)


def test_runs_are_read_at_once(path, monkeypatch):
    rows = RowFile.open(path)
    sizes = []
    pread = os.pread

    def counting(file, size, at):
        sizes.append(size // 48)
        return pread(file, size, at)

    monkeypatch.setattr("os.pread", counting)
    wanted = np.array([[3, 4, 5], [6, 6, 5], [49, 0, 1]])
    np.testing.assert_array_equal(rows[wanted], ARRAY[wanted])
    assert sizes == [4, 1, 1, 1, 2]


def test_what_is_sent_to_another_process_opens_the_file_again(path):
    rows = RowFile.open(path)
    first = rows[np.arange(3)]
    again = copy.copy(rows)  # by what pickle would send
    assert vars(again).keys() == {"path", "shape", "first_byte"}
    assert (again.shape, len(again)) == ((50, 4, 3), 50)
    np.testing.assert_array_equal(again[np.arange(3)], first)


@pytest.mark.parametrize("wrong", [-1, 50])
def test_rows_that_there_are_not(path, wrong):
    with pytest.raises(IndexError, match=rf"row {wrong} does not lie in \[0, 50\)"):
        RowFile.open(path)[np.array([3, wrong])]


def test_files_that_are_none(tmp_path: Path, path):
    for name, content in (("text.npy", b"no array"), ("cut.npy", path.read_bytes()[:40])):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(DamagedFileError, match=rf"{name} is damaged \(it is no \.npy file"):
            RowFile.open(tmp_path / name)
    np.save(tmp_path / "double.npy", ARRAY.astype(np.float64))
    with pytest.raises(DamagedFileError, match=re.escape("it holds float64 (50, 4, 3), not rows of float32")):
        RowFile.open(tmp_path / "double.npy")
    (tmp_path / "short.npy").write_bytes(path.read_bytes()[:-100])
    with pytest.raises(DamagedFileError, match=re.escape("it does not have the bytes of float32 (50, 4, 3)")):
        RowFile.open(tmp_path / "short.npy")


def test_a_file_that_becomes_shorter(tmp_path: Path, path):
    (tmp_path / "short.npy").write_bytes(path.read_bytes())
    short = RowFile.open(tmp_path / "short.npy")
    (tmp_path / "short.npy").write_bytes(path.read_bytes()[:-100])
    np.testing.assert_array_equal(short[np.array([7])], ARRAY[[7]])
    with pytest.raises(StoreError, match="has become shorter than its 50 rows"):
        short[np.array([49])]


@pytest.mark.parametrize("shape", [(-1, 3), (3, -1)])
def test_a_header_of_negative_sizes(tmp_path: Path, shape):
    with (tmp_path / "odd.npy").open("wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f4", "fortran_order": False, "shape": shape})
    with pytest.raises(DamagedFileError, match="not rows of float32"):
        RowFile.open(tmp_path / "odd.npy")


def test_written_rows_are_read_back(tmp_path: Path):
    digest = write_rows(tmp_path / "rows.npy", ARRAY.shape, [ARRAY[:7], ARRAY[7:]])
    np.testing.assert_array_equal(np.load(tmp_path / "rows.npy"), ARRAY)
    assert digest == FileDigest(sha256_of(tmp_path / "rows.npy"), (tmp_path / "rows.npy").stat().st_size)
    assert file_fault(tmp_path / "rows.npy", digest) == ""


@pytest.mark.parametrize(
    ("blocks", "says"), [([ARRAY[:7]], "7 rows, expected 50"), ([ARRAY[:, :3]], r"rows of shape \(3, 3\)")]
)
def test_rows_of_another_shape_are_not_written(tmp_path: Path, blocks, says):
    with pytest.raises(ValueError, match=says):
        write_rows(tmp_path / "rows.npy", ARRAY.shape, blocks)
    assert list(tmp_path.iterdir()) == []


def test_a_large_file_is_hashed_if_asked(tmp_path: Path, path, monkeypatch):
    """And its size is compared in any case."""
    monkeypatch.setattr(checksums, "MOST_HASHED_BYTES", 1000)
    copy = tmp_path / "large.npy"
    digest = FileDigest(sha256_of(path), path.stat().st_size)
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    copy.write_bytes(content)
    assert file_fault(copy, digest) == ""
    assert file_fault(copy, digest, deep=True) == "its content is not what was written"
    copy.write_bytes(content[:-1])
    assert "bytes instead of" in file_fault(copy, digest)


def test_no_page_of_the_file_stays(tmp_path):
    """A map of as much would: that is the point."""

    def file_kilobytes() -> int:
        status = Path("/proc/self/status")
        if not status.is_file():
            pytest.skip("needs Linux's /proc")
        return int(re.findall(r"^RssFile:\s+(\d+)", status.read_text(), re.MULTILINE)[0])

    large = tmp_path / "large.npy"
    np.save(large, np.zeros((8_000, 22, 3, 16), np.float32))
    wanted = np.random.default_rng(0).integers(0, 8_000, 4_000)
    rows = RowFile.open(large)
    before = file_kilobytes()
    rows[wanted]
    assert file_kilobytes() - before < 2_000
    mapped = np.load(large, mmap_mode="r")
    mapped[wanted]
    assert file_kilobytes() - before > 10_000
