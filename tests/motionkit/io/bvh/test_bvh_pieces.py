"""Long BVH files are read some frames at a time: to the same motion, the same errors, and in so much memory."""

import re
import subprocess
import sys
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion
from motionkit.io.bvh.document import read_bvh
from motionkit.io.reading import read
from motionkit.io.scan import scan
from tests.helpers.every_format import bodies
from tests.helpers.format_samples import NUM_BVH_CHANNELS, bvh_text
from tests.helpers.repository import REPOSITORY
from tests.motionkit.io.bvh.test_bad_bvh import BAD

ROOT = REPOSITORY


def in_pieces(patched: pytest.MonkeyPatch, frames: int, num_bytes: int) -> None:
    """No file is held, and short ones have many pieces."""
    patched.setattr("motionkit.io.bvh.document.HELD_BYTES", 0)
    patched.setattr("motionkit.io.bvh.frame_lines.TABLE_FRAMES", frames)
    patched.setattr("motionkit.io.source.number_table.BLOCK_BYTES", num_bytes)
    patched.setattr("motionkit.io.source.source_file.PART_BYTES", num_bytes)
    patched.setattr("motionkit.io.bvh.text.PART_BYTES", num_bytes)


def rows(num_frames: int) -> np.ndarray:
    table = np.random.default_rng(3).normal(0, 30, (num_frames, NUM_BVH_CHANNELS)).round(3)
    table[:, 1] = 95
    return table


def t_pose_first(num_frames: int) -> str:
    table = rows(num_frames)
    table[0, 3:] = 0
    table[1, :3] = table[0, :3]
    return bvh_text(table.tolist())


def with_places(text: str, table: np.ndarray) -> str:
    """The same joints, each with position channels: the knees' places change, the others rest."""
    head, body = text.split("MOTION")
    head = head.replace("CHANNELS 3 ", "CHANNELS 6 Xposition Yposition Zposition ")
    offsets = [list(map(float, found)) for found in re.findall(r"OFFSET (\S+) (\S+) (\S+)\n\s*CHANNELS", head)]
    stretch = 1 + 0.1 * np.sin(np.arange(len(table)))
    columns = [table[:, :6]]
    for joint, offset in enumerate(offsets[1:]):
        moves = stretch if offset == [0, -42, 0] else np.ones_like(stretch)
        columns += [moves[:, None] * offset, table[:, 6 + 3 * joint : 9 + 3 * joint]]
    lines = [" ".join(f"{value:g}" for value in row) for row in np.concatenate(columns, axis=1)]
    return f"{head}MOTION" + "\n".join([*body.splitlines()[:3], *lines]) + "\n"


def along_z(text: str) -> str:
    return re.sub(r"OFFSET (\S+) (\S+) (\S+)", r"OFFSET \1 \3 \2", text)


def carried(text: str) -> str:
    """A root that only carries the hips."""
    hips, rest = text.split("MOTION")
    frames = [f"1 2 3 0 10 20 {line}" for line in rest.splitlines()[3:]]
    channels = "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"
    root = f"HIERARCHY\nROOT Carrier\n{{\nOFFSET 0 0 0\n{channels}\n"
    inner = hips.replace("HIERARCHY\nROOT", "JOINT")
    return f"{root}{inner}}}\nMOTION" + "\n".join([*rest.splitlines()[:3], *frames]) + "\n"


TAKES = {
    "plain": bvh_text(rows(50).tolist()),
    "a T-pose first": t_pose_first(50),
    "one frame": bvh_text(rows(1).tolist()),
    "as many as a piece": bvh_text(rows(7).tolist()),
    "blank lines": bvh_text(rows(50).tolist()).replace("\n", "\n\n"),
    "old line ends": bvh_text(rows(50).tolist()).replace("\n", "\r"),
    "bones that change": with_places(bvh_text(), rows(50)).replace("Frames: 4", "Frames: 50"),
    "along z": along_z(bvh_text(rows(50).tolist())),
    "a root that carries another": carried(bvh_text(rows(50).tolist())),
}


@pytest.mark.parametrize("frames", [7, 20])
@pytest.mark.parametrize("name", TAKES)
def test_pieces_make_the_same_motion(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, frames: int) -> None:
    path = tmp_path / "take.bvh"
    path.write_bytes(TAKES[name].encode())
    whole = read_bvh(path)
    in_pieces(monkeypatch, frames, 300)
    assert_same(read_bvh(path), whole)


def assert_same(found: Motion, expected: Motion) -> None:
    for name in ("joint_positions", "local_rotations", "root_translation"):
        one, other = getattr(found, name), getattr(expected, name)
        assert (one is None) == (other is None)
        assert one is None or np.array_equal(one, other)
    assert found.skeleton.fingerprint == expected.skeleton.fingerprint
    assert (found.timegrid, found.provenance) == (expected.timegrid, expected.provenance)


def test_the_takes_are_what_they_are_called(tmp_path: Path) -> None:
    operations = {}
    for name, text in TAKES.items():
        (tmp_path / "take.bvh").write_text(text)
        operations[name] = " ".join(read_bvh(tmp_path / "take.bvh").provenance.operations)
    assert "frame 0 dropped" in operations["a T-pose first"] and "turned from z up" in operations["along z"]
    assert "(LeftLeg, LeftFoot, RightLeg, RightFoot)" in operations["bones that change"]
    assert "folded into 'Hips'" in operations["a root that carries another"]


@pytest.mark.parametrize("name", BAD)
def test_what_is_wrong_is_found_in_pieces_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    content, *_ = BAD[name]
    path = tmp_path / "bad.bvh"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(FormatError) as whole:
        read_bvh(path)
    in_pieces(monkeypatch, 2, 100)
    with pytest.raises(FormatError) as pieces:
        read_bvh(path)
    assert str(pieces.value) == str(whole.value) and pieces.value.reason == whole.value.reason


def test_a_file_without_line_ends_is_not_read_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("motionkit.io.source.source_file.LONGEST_LINE", 5000)
    path = tmp_path / "take.bvh"
    path.write_text(bvh_text()[:-1] + " 0" * 10_000)
    in_pieces(monkeypatch, 2, 300)
    with pytest.raises(FormatError, match="a line of more than 0 MiB") as caught:
        read_bvh(path)
    assert caught.value.reason == "range"
    monkeypatch.setattr("motionkit.io.bvh.text.LARGEST_HEAD", 1000)
    path.write_text("HIERARCHY\n" + "\n" * 20_000)
    with pytest.raises(FormatError, match="expected a hierarchy and MOTION") as caught:
        read_bvh(path)
    assert caught.value.reason == "too-large"


def test_a_longer_take_than_a_store_takes_is_refused_before_it_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "take.bvh"
    path.write_text(bvh_text(rows(50).tolist())[:-1] + "x\n")
    for name, limit in (("MAX_FRAMES", 49), ("MAX_POSES", 49 * 16)):
        with monkeypatch.context() as patched:
            patched.setattr(f"motionkit.io.source.source_file.{name}", limit)
            with pytest.raises(FormatError, match="50 frames of 16 joints, expected at most 49 frames") as caught:
                read_bvh(path)
        assert caught.value.reason == "too-large"
    np.savez(tmp_path / "take.npz", joint_positions=bodies(8, 22), fps=30)
    monkeypatch.setattr("motionkit.io.source.source_file.MAX_FRAMES", 7)
    (item,) = scan([tmp_path / "take.npz"]).items
    with pytest.raises(FormatError, match="8 frames of 22 joints") as caught:
        read(item)
    assert caught.value.reason == "too-large"


def test_the_lines_of_the_page_cut_a_take(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("long.bvh").write_text(bvh_text(rows(50).tolist()))
    whole = read_bvh(Path("long.bvh"))
    page = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
    code = page.partition("### Long takes")[2].partition("```python\n")[2].partition("```")[0]
    exec(code.replace("1_000_000", "20"), {})
    parts = [read_bvh(path) for path in sorted(Path().glob("long-*.bvh"))]
    assert [part.num_frames for part in parts] == [20, 20, 10]
    assert np.array_equal(np.concatenate([part.joint_positions for part in parts]), whole.joint_positions)


# In a process of its own, for here every array's shape is checked, which takes memory.
PEAK = """
import sys, tracemalloc
from pathlib import Path
from motionkit.io.scan import scan
from motionkit.io.registry import ReadOptions
from motionkit.store.chunks import NumberedItem, read_chunk

for number, path in enumerate(map(Path, sys.argv[1:])):
    (path.parent / "segments").mkdir(exist_ok=True)
    tracemalloc.start()
    (item,) = scan([path]).items
    (read,) = read_chunk([NumberedItem(item, number)], path.parent, ReadOptions()).outcomes
    print(read.row["num_frames"] * read.skeleton.num_joints, tracemalloc.get_traced_memory()[1])
    del read
    tracemalloc.stop()
"""


@pytest.mark.parametrize("kind", ["plain", "bones that change", "along z"])
def test_memory_grows_by_60_bytes_for_each_joint_and_frame(tmp_path: Path, kind: str) -> None:
    head, _, frames = TAKES[kind].partition("Frames: 50\n")
    step, *lines = frames.splitlines()
    paths = []
    for thousands in (1, 10, 30):
        paths.append(tmp_path / f"{thousands}.bvh")
        lines_of_take = "\n".join(islice(lines * (20 * thousands), 1000 * thousands))
        paths[-1].write_text(f"{head}Frames: {1000 * thousands}\n{step}\n{lines_of_take}\n")
    ran = subprocess.run([sys.executable, "-c", PEAK, *paths], check=True, capture_output=True, text=True)
    _, medium, long = ([int(number) for number in line.split()] for line in ran.stdout.splitlines())
    assert (long[1] - medium[1]) / (long[0] - medium[0]) < 60
