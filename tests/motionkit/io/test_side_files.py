"""Files beside the motions (tables, texts, manifests, licences, rules, maps) that are hostile or broken."""

import os
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from motionkit.core.errors import FormatError, MotionkitError
from motionkit.io.registry import ReadOptions
from motionkit.io.scan import read, scan
from motionkit.io.source_file import read_bytes
from tests.helpers.every_format import SOURCES
from tests.helpers.format_samples import bvh_text
from tests.helpers.side_files import BESIDE

OPTIONS = ReadOptions(fps=Fraction(30))
DEEP = b"[" * 100_000
HOSTILE = {
    "nothing": b"",
    "zeros": bytes(512),
    "not UTF-8": b"caf\xe9,caption\n\xff\xfe",
    "UTF-16": "file,caption\ntake.bvh,walks\n".encode("utf-16"),
    "nested without end": b'{"fps": ' + DEEP,
    "a number of 5,000 digits": b'{"fps": ' + b"9" * 5000 + b"}",
    "a quote without end": b'file,caption\n"take.bvh,walks\n',
    "hexadecimal digits without end": b"fps = 0x" + b"f" * 5000 + b"\n[[rule]]\nfiles='a'\nfps = 0x" + b"f" * 5000,
    "numbers without end in a table": b"file,fps,num_frames,captions\ntake.bvh," + b",".join([b"9" * 5000] * 3) + b"\n",
    "times beyond all floats": b'file,captions\ntake.bvh,"[{""text"": ""a"", ""start_seconds"": '
    + b"9" * 400
    + b'}]"\n',
    "half a surrogate": b'file,captions\ntake.bvh,"[""\\ud800""]"\n',
    "a path that leaves the folder": b"file,caption\n../../../etc/passwd,x\n/etc/passwd,y\ntake.bvh,walks\n",
    "a name that no file can have": b"file,caption\n" + b"x" * 300 + b".bvh,x\n" + b"x/" * 3000 + b"y,z\n",
    "a column twice": b"file,file,caption,caption\ntake.bvh,take.bvh,a,b\n",
    "an fps of nan": b'{"fps": NaN}',
}


def write_beside(folder: Path, side: str, content: bytes) -> None:
    name, file_name, _ = BESIDE[side]
    SOURCES[name](folder)
    (folder / file_name).parent.mkdir(exist_ok=True)
    (folder / file_name).write_bytes(content)


def read_all(folder: Path, options: ReadOptions) -> None:
    """Scan and read; anything but an explained error comes out as it is."""
    for item in scan([folder], options).items:
        assert item.path.is_relative_to(folder.resolve())
        try:
            assert np.isfinite(read(item, options).joint_positions).all()
        except MotionkitError as problem:
            assert str(problem)


@pytest.mark.parametrize("content", HOSTILE)
@pytest.mark.parametrize("side", BESIDE)
def test_hostile_files_beside_motions_are_explained(tmp_path: Path, side: str, content: str) -> None:
    write_beside(tmp_path, side, HOSTILE[content])
    read_all(tmp_path, OPTIONS if side == "annotations" else ReadOptions())


def test_a_pipe_among_the_files_is_not_waited_for(tmp_path: Path) -> None:
    (tmp_path / "walk.bvh").write_text(bvh_text())
    for name in ("run.bvh", "captions.csv"):
        os.mkfifo(tmp_path / name)
    found = scan([tmp_path])
    assert [item.path.name for item in found.items] == ["walk.bvh"] and not found.problems
    with pytest.raises(FormatError, match="a pipe"):
        read_bytes(tmp_path / "run.bvh")
