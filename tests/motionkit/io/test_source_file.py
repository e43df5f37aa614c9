"""A file's bytes are read once and held once."""

import tracemalloc
from pathlib import Path

import pytest

from motionkit.core.errors import FormatError
from motionkit.io.source_file import read_bytes


@pytest.mark.parametrize("content", [b"", b" \t\r\n\0" * 70_000])
def test_a_file_of_blanks_is_empty(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.bvh"
    path.write_bytes(content)
    with pytest.raises(FormatError) as caught:
        read_bytes(path)
    assert caught.value.reason == "empty"


def test_reading_takes_the_memory_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "a.bvh"
    path.write_bytes(b"0.0 " * 5_000_000 + b"\n")
    tracemalloc.start()
    try:
        content = read_bytes(path)
        assert tracemalloc.get_traced_memory()[1] < 1.1 * len(content)
    finally:
        tracemalloc.stop()
