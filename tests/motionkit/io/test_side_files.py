"""Files beside the motions (tables, texts, manifests, licences, rules, maps) that are hostile or broken."""

import os
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from motionkit.core.errors import FormatError, MotionkitError
from motionkit.core.skeletons.families import read_skeleton_map
from motionkit.io.framerate_rules import read_rules
from motionkit.io.reading import read
from motionkit.io.registry import ReadOptions
from motionkit.io.scan import scan
from motionkit.io.source_file import read_bytes
from motionkit.store.ingest import ingest
from tests.helpers.damage import damaged
from tests.helpers.every_format import SOURCES
from tests.helpers.format_samples import bvh_text
from tests.helpers.side_files import BESIDE, MAP, RULES

OPTIONS = ReadOptions(fps=Fraction(30))
DEEP = b"[" * 100_000
HOSTILE = {
    "nothing": b"",
    "zeros": bytes(512),
    "not UTF-8": b"caf\xe9,caption\n\xff\xfe",
    "UTF-16": "file,caption\ntake.bvh,walks\n".encode("utf-16"),
    "nested without end": DEEP,
    "nested in an object": b'{"fps": ' + DEEP,
    "a number of 5,000 digits": b'{"fps": ' + b"9" * 5000 + b"}",
    "a quote without end": b'file,caption\n"take.bvh,walks\n',
    "one line of a megabyte": b"file,caption\ntake.bvh," + b"x" * (1 << 20) + b"\n",
    "hexadecimal digits without end": b"fps = 0x" + b"f" * 5000 + b"\n[[rule]]\nfiles='a'\nfps = 0x" + b"f" * 5000,
    "numbers without end in a table": b"file,fps,num_frames,captions\ntake.bvh," + b",".join([b"9" * 5000] * 3) + b"\n",
    "a framerate beyond all floats": b'{"fps": ' + b"9" * 400 + b"}",
    "a ratio beyond all floats": b"file,fps\ntake.bvh," + b"9" * 400 + b"/1\n",
    "times beyond all floats": b'file,captions\ntake.bvh,"[{""text"": ""a"", ""start_seconds"": '
    + b"9" * 400
    + b'}]"\n',
    "half a surrogate": b'file,captions\ntake.bvh,"[""\\ud800""]"\n',
    "a path that leaves the folder": b"file,caption\n../../../etc/passwd,x\n/etc/passwd,y\ntake.bvh,walks\n",
    "a name that no file can have": b"file,caption\n"
    + b"x" * 300
    + b".bvh,x\n"
    + b"x/" * 3000
    + b"y,z\ntake.bvh,walks\n",
    "carriage returns": b"file,caption\rtake.bvh,walks\r",
    "a column twice": b"file,file,caption,caption\ntake.bvh,take.bvh,a,b\n",
    "no fps at all": b'{"fps": null}',
    "an fps of nan": b'{"fps": NaN}',
}


def write_beside(folder: Path, side: str, content: bytes) -> None:
    name, file_name, _ = BESIDE[side]
    SOURCES[name](folder)
    (folder / file_name).parent.mkdir(exist_ok=True)
    (folder / file_name).write_bytes(content)


def read_all(folder: Path, options: ReadOptions) -> None:
    """Scan and read; anything but an explained error comes out as it is."""
    found = scan([folder], options)
    for item in found.items:
        assert item.path.is_relative_to(folder.resolve())
        try:
            assert np.isfinite(read(item, options).joint_positions).all()
        except MotionkitError as problem:
            assert str(problem)


@pytest.mark.parametrize("content", HOSTILE)
@pytest.mark.parametrize("side", BESIDE)
@pytest.mark.parametrize("options", [OPTIONS, ReadOptions()], ids=["given", "found"])
def test_hostile_files_beside_motions_are_explained(tmp_path, side, content, options):
    write_beside(tmp_path, side, HOSTILE[content])
    read_all(tmp_path, options)


@pytest.mark.parametrize("side", BESIDE)
@settings(max_examples=40, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_damaged_files_beside_motions_are_explained(tmp_path_factory, side, data):
    folder = tmp_path_factory.mktemp("side", numbered=True)
    write_beside(folder, side, data.draw(damaged(BESIDE[side][2])))
    read_all(folder, ReadOptions())


@pytest.mark.parametrize(("content", "reader"), [(RULES, read_rules), (MAP, read_skeleton_map)], ids=["rules", "map"])
@settings(max_examples=80, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_tables_of_the_user_are_explained(tmp_path, content, reader: Callable[[Path], object], data):
    path = tmp_path / "table.toml"
    path.write_bytes(data.draw(damaged(content) | st.sampled_from(sorted(HOSTILE.values()))))
    try:
        reader(path)
    except MotionkitError as problem:
        assert str(path) in str(problem) or path.name in str(problem)


def test_captions_that_are_no_text_cost_their_row_only(tmp_path):
    """A JSON escape can say what no text is; a store holds text."""
    source = tmp_path / "source"
    source.mkdir()
    write_beside(source, "annotations", HOSTILE["half a surrogate"])
    SOURCES["csv"](source).rename(source / "other.csv")
    report = ingest([source], tmp_path / "store", num_workers=1, options=OPTIONS)
    assert report.num_stored == 2
    assert [(problem.reason, problem.line) for problem in report.problems] == [("annotations", 2)]


@pytest.mark.parametrize("suffix", [".bvh", ".amc", ".c3d", ".json", ".npz", ".pkl", ".npy", ".csv", ".txt", ".asf"])
def test_links_that_lead_nowhere_or_to_themselves_are_reported(tmp_path, suffix):
    SOURCES["csv"](tmp_path)
    name = "a0_d1_p001_c1_color" if suffix in (".npz", ".pkl") else "walk"
    (tmp_path / f"{name}{suffix}").symlink_to(tmp_path / f"{name}{suffix}")
    (tmp_path / f"gone{suffix}").symlink_to(tmp_path / "nowhere")
    (tmp_path / "LICENSE").symlink_to(tmp_path / "LICENSE")
    read_all(tmp_path, OPTIONS)


@pytest.mark.parametrize("suffix", [".bvh", ".amc", ".c3d", ".json", ".npz", ".pkl", ".npy", ".csv", ".txt", ".asf"])
def test_folders_named_like_files_are_no_motions(tmp_path, suffix):
    SOURCES["csv"](tmp_path)
    (tmp_path / f"walk{suffix}").mkdir()
    (tmp_path / "LICENSE").mkdir()
    (tmp_path / "motions.json").mkdir()
    read_all(tmp_path, OPTIONS)


@pytest.mark.parametrize(
    ("content", "reason", "words"),
    [
        ("file,caption\nwalk.bvh,à pied\n".encode("latin-1"), "encoding", "line 2: byte 0xe0 is not UTF-8"),
        ("file,caption\nwalk.bvh,walks\n".encode("utf-16"), "encoding", "line 1: byte 0xff is not UTF-8"),
        (b"file;caption\nwalk.bvh;walks\n", "annotations", "separated by commas"),
    ],
)
def test_a_table_that_cannot_be_read_is_reported_and_not_passed_over(
    tmp_path: Path, content: bytes, reason: str, words: str
) -> None:
    (tmp_path / "walk.bvh").write_text(bvh_text())
    (tmp_path / "captions.csv").write_bytes(content)
    found = scan([tmp_path])
    assert len(found.items) == 1
    assert [problem.reason for problem in found.problems] == [reason] and words in str(found.problems[0])


def test_a_pipe_among_the_files_is_not_waited_for(tmp_path: Path) -> None:
    (tmp_path / "walk.bvh").write_text(bvh_text())
    for name in ("run.bvh", "captions.csv"):
        os.mkfifo(tmp_path / name)
    found = scan([tmp_path])
    assert [item.path.name for item in found.items] == ["walk.bvh"] and not found.problems
    with pytest.raises(FormatError, match="a pipe"):
        read_bytes(tmp_path / "run.bvh")


def test_lines_that_end_in_a_carriage_return_alone(tmp_path: Path) -> None:
    (tmp_path / "walk.bvh").write_text(bvh_text())
    (tmp_path / "old.bvh").write_bytes(bvh_text().replace("\n", "\r").encode())
    old, walk = (read(item) for item in scan([tmp_path]).items)
    assert np.array_equal(old.joint_positions, walk.joint_positions) and old.fps == walk.fps
