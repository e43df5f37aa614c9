"""Every format of the catalogue, read as ingest does it; hostile files beside motions end in explained errors only.

Damaged files of every format are those of the drill (tests/benchmarks/test_trust.py).
"""

import os
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import motionkit as mk
from motionkit.io import vector_layouts
from motionkit.io.bvh import read_bvh
from motionkit.io.npz import read_npz
from motionkit.io.registry import ReadOptions, readers
from motionkit.io.scan import read, scan
from motionkit.io.source_file import read_bytes, read_table
from tests.helpers.every_format import SOURCES
from tests.helpers.format_samples import bvh_text
from tests.helpers.refusal import refusal
from tests.helpers.side_files import BESIDE

OPTIONS = ReadOptions(fps=Fraction(30))
G1_TABLES = ("g1-csv", "g1-csv-wxyz", "g1-csv-xyzw")


def read_source(source: Path, options: ReadOptions = OPTIONS) -> tuple[list[mk.Motion], list[mk.FormatError]]:
    """All motions of a source and all problems, as ingest meets them."""
    found = scan([source], options)
    motions, problems = [], list(found.problems)
    for item in found.items:
        try:
            motions.append(read(item, options))
        except mk.FormatError as problem:
            problems.append(problem)
    return motions, problems


def test_there_is_a_source_of_every_format():
    assert {*SOURCES, *vector_layouts.LAYOUTS, *G1_TABLES, "easymocap", "motius"} == set(readers())


@pytest.mark.parametrize("name", SOURCES)
def test_the_undamaged_source_is_read_and_nothing_of_it_is_ignored(tmp_path, name):
    SOURCES[name](tmp_path)
    (tmp_path / "LICENSE.txt").write_text("MIT")
    found = scan([tmp_path], OPTIONS)
    [item] = found.items
    assert (item.format, found.ignored) == (name, ())
    assert np.isfinite(read(item, OPTIONS).joint_positions).all()


HOSTILE = {
    "nothing": b"",
    "not UTF-8": b"caf\xe9,caption\n\xff\xfe",
    "nested without end": b'{"fps": ' + b"[" * 100_000,
    "hexadecimal digits without end": b"fps = 0x" + b"f" * 5000 + b"\n[[rule]]\nfiles='a'\nfps = 0x" + b"f" * 5000,
    "numbers without end in a table": b"file,fps,num_frames,captions\ntake.bvh," + b",".join([b"9" * 5000] * 3) + b"\n",
    "a path that leaves the folder": b"file,caption\n../../../etc/passwd,x\n/etc/passwd,y\ntake.bvh,walks\n",
    "a name that no file can have": b"file,caption\n" + b"x" * 300 + b".bvh,x\n" + b"x/" * 3000 + b"y,z\n",
    "a column twice": b"file,file,caption,caption\ntake.bvh,take.bvh,a,b\n",
}


@pytest.mark.parametrize("content", HOSTILE)
@pytest.mark.parametrize("side", BESIDE)
def test_hostile_files_beside_motions_are_explained(tmp_path, side, content):
    name, file_name, _ = BESIDE[side]
    SOURCES[name](tmp_path)
    (tmp_path / file_name).parent.mkdir(exist_ok=True)
    (tmp_path / file_name).write_bytes(HOSTILE[content])
    motions, _ = read_source(tmp_path, OPTIONS if side == "annotations" else ReadOptions())
    for motion in motions:
        assert np.isfinite(motion.joint_positions).all()


def test_a_pipe_among_the_files_is_not_waited_for(tmp_path):
    SOURCES["bvh"](tmp_path)
    for name in ("run.bvh", "captions.csv"):
        os.mkfifo(tmp_path / name)
    found = scan([tmp_path])
    assert [item.path.name for item in found.items] == ["take.bvh"] and not found.problems
    assert refusal(read_bytes, tmp_path / "run.bvh").path.name == "run.bvh"


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
    for reader, path in ((read_bvh, walk), (read_npz, array)):
        assert refusal(reader, path).reason == "frame-time"


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
