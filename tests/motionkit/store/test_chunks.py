"""Chunks of the sources: how they are cut, what a worker returns for one, and workers that die of one."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from motionkit.core.errors import FormatError, StoreError
from motionkit.io.registry import ReadOptions, SourceItem
from motionkit.store import Store, chunks
from motionkit.store.chunks import NumberedItem, ReadSequence, chunks_of, read_chunk
from motionkit.store.ingest import ingest
from tests.helpers.small_bvh import two_joints_bvh


def folder_of(tmp_path: Path, lengths: list[int]) -> Path:
    """A folder of BVH files 0.bvh, 1.bvh … with so many frames."""
    folder = tmp_path / "takes"
    folder.mkdir()
    for number, length in enumerate(lengths):
        rows = [f"{frame} 90 0 0 0 {frame / 7:.6f} 0 {frame} 0" for frame in range(length)]
        (folder / f"{number}.bvh").write_text(two_joints_bvh(rows))
    return folder


@pytest.mark.parametrize(
    ("sizes", "expected"),
    [
        ([40, 40, 20, 1], [3, 1]),
        # A file that is larger is a chunk of its own.
        ([40, 150, 40], [1, 1, 1]),
        # One of many sequences stays together up to the greatest number of sequences.
        ([(90, 3), (20, 2), 80], [3, 3]),
        ([(10, 7), 95], [5, 2, 1]),
        ([0] * 12, [5, 5, 2]),
        ([], []),
        # A 64th of all bytes, but not without bounds.
        ([10] * 640, [5] * 128),
        ([50] * 256, [4] * 64),
        ([300] * 200, [3] * 66 + [2]),
    ],
)
def test_bytes_and_items_of_a_chunk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sizes: list[int | tuple[int, int]], expected: list[int]
) -> None:
    for name, value in (("CHUNK_BYTES", 100), ("CHUNK_ITEMS", 5), ("MAX_CHUNK_BYTES", 1000), ("MAX_CHUNK_ITEMS", 5)):
        monkeypatch.setattr(chunks, name, value)
    pairs = [size if isinstance(size, tuple) else (size, 1) for size in sizes]
    monkeypatch.setattr(chunks, "_size", lambda path: pairs[int(path.stem)][0])
    items = [
        SourceItem("bvh", tmp_path / f"{number}.bvh", tmp_path, f"take-{number}-{i}")
        for number, (_, num_items) in enumerate(pairs)
        for i in range(num_items)
    ]
    found = list(chunks_of(items))
    assert [item for chunk in found for item in chunk] == items
    assert [len(chunk) for chunk in found] == expected


def test_a_worker_writes_what_has_an_index_and_returns_what_it_read(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, [300, 5, 7])
    (folder / "1.bvh").write_text("HIERARCHY\n")
    (tmp_path / chunks.MOTIONS_FOLDER).mkdir()
    items = [SourceItem("bvh", folder / f"{number}.bvh", folder, f"takes/{number}") for number in (0, 1, 2, 2, 3)]
    numbered = [NumberedItem(item, index) for item, index in zip(items, (4, 5, None, 6, 7), strict=True)]
    read, again = (read_chunk(numbered, tmp_path, ReadOptions()) for _ in range(2))
    assert read.part is not None and again.part is not None and read.part.path != again.part.path
    assert read.part.entry == again.part.entry
    first, broken, known, last, gone = read.outcomes
    assert isinstance(broken, FormatError) and isinstance(gone, FormatError)
    assert gone.reason == "not-visible" and "there is no such file on" in str(gone)
    assert isinstance(first, ReadSequence) and isinstance(known, ReadSequence) and isinstance(last, ReadSequence)
    assert [(each.row["sequence_index"], each.row["part_row"]) for each in (first, last)] == [(4, 0), (6, 1)]
    assert "part_row" not in known.row and known.row["sequence_id"] == "takes/2"
    assert first.skeleton is last.skeleton is known.skeleton
    assert read_chunk([numbered[2]], tmp_path, ReadOptions()).part is None
    with pytest.raises(StoreError, match=rf"there is no store {re.escape(str(tmp_path))}/away on .* all machines"):
        read_chunk([], tmp_path / "away", ReadOptions())


@pytest.mark.parametrize("workers", [1, 2])
def test_an_index_is_the_place_among_what_is_new(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, workers: int) -> None:
    """Whatever failed and whatever is there already: so a part's bytes do not depend on other parts."""
    monkeypatch.setattr(chunks, "CHUNK_BYTES", 2000)
    folder = folder_of(tmp_path, [20, 30, 40, 50, 60])
    broken = folder / "2.bvh"
    good = broken.read_text()
    broken.write_text("HIERARCHY\n")
    first = ingest([folder], tmp_path / "store", num_workers=workers)
    assert (first.num_stored, len(first.problems)) == (4, 1)
    assert Store.open(tmp_path / "store").sequences["sequence_index"].tolist() == [0, 1, 3, 4]
    broken.write_text(good)
    (folder / "5.bvh").write_text((folder / "4.bvh").read_text())
    second = ingest([folder], tmp_path / "store", num_workers=workers)
    assert (second.num_stored, second.num_already_stored) == (2, 4)
    store = Store.open(tmp_path / "store")
    assert store.sequences["sequence_index"].tolist() == [0, 1, 3, 4, 5, 6]
    assert [store.read(index).num_frames for index in (0, 3, 5, 6)] == [20, 50, 40, 60]
    names = sorted(f"{chunks.MOTIONS_FOLDER}/{path.name}" for path in (store.path / chunks.MOTIONS_FOLDER).iterdir())
    assert names == list(store.manifest.parts)


KILLED = """
import os, signal, sys
from pathlib import Path
from motionkit.store import chunks
from motionkit.store.ingest import ingest

folder, store, when = map(Path, sys.argv[1:])
marker, finish, read = folder.parent / "died", chunks.PartWriter.finish, chunks.read
chunks.CHUNK_BYTES = 12000

def die(once):
    if not (once and marker.exists()):
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)

def deadly(item, options):
    if when.name != "written" and item.path.stem == "1":
        die(once=when.name == "reading")
    return read(item, options)

def finish_or_die(part):
    written = finish(part)
    if when.name == "written" and part.num_rows > 1:
        die(once=True)
    return written

chunks.read, chunks.PartWriter.finish = deadly, finish_or_die
if __name__ == "__main__":
    report = ingest([folder], store, num_workers=2)
    reasons = [(problem.path.name, problem.reason) for problem in report.problems]
    assert reasons == ([("1.bvh", "worker-died")] if when.name == "always" else []), reasons
"""


@pytest.mark.parametrize("when", ["reading", "written", "always"])
def test_a_worker_that_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, when: str) -> None:
    """Once: its chunk is done again, whole. Always: the file is named, and the others of its chunk are stored."""
    folder = folder_of(tmp_path, [20, 40, 300, 30, 600, 50])
    monkeypatch.setattr(chunks, "CHUNK_BYTES", 12000)
    program = tmp_path / "program.py"
    program.write_text(KILLED)
    subprocess.run([sys.executable, program, folder, tmp_path / "store", when], check=True)
    assert (tmp_path / "died").exists()
    if when == "always":
        monkeypatch.setattr(chunks, "_size", {path: path.stat().st_size for path in folder.iterdir()}.__getitem__)
        (folder / "1.bvh").write_text("HIERARCHY\n")  # a file that cannot be read leaves the same gap
    ingest([folder], tmp_path / "undisturbed", num_workers=1)
    stores = [Store.open(tmp_path / name) for name in ("undisturbed", "store")]
    assert len(stores[0].manifest.parts) > 2
    assert stores[0].fingerprint == stores[1].fingerprint
    names = [sorted(path.name for path in (store.path / chunks.MOTIONS_FOLDER).iterdir()) for store in stores]
    assert names[0] == names[1]


@pytest.mark.parametrize("workers", [1, 2])
def test_a_problem_under_stop_leaves_no_part_of_other_chunks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, workers: int
) -> None:
    monkeypatch.setattr(chunks, "CHUNK_BYTES", 1)
    folder = folder_of(tmp_path, [20, 30, 40, 50, 60])
    (folder / "3.bvh").write_text("HIERARCHY\n")
    report = ingest([folder], tmp_path / "store", num_workers=workers, on_error="stop")
    assert (report.committed, len(report.problems)) == (False, 1)
    assert list((tmp_path / "store" / chunks.MOTIONS_FOLDER).iterdir()) == []
