"""Chunks of the sources: how they are cut, and what a worker returns for one."""

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


def bvh(count: int) -> str:
    return two_joints_bvh([f"{frame} 90 0 0 0 {frame / 7:.6f} 0 {frame} 0" for frame in range(count)])


def items_of(folder: Path, sizes: list[int | tuple[int, int]]) -> list[SourceItem]:
    """Items of files with so many bytes; for a pair, as many items of one file as its second number says."""
    items = []
    for number, size in enumerate(sizes):
        num_bytes, num_items = size if isinstance(size, tuple) else (size, 1)
        path = folder / f"{number}.bvh"
        path.write_bytes(bytes(num_bytes))
        items += [SourceItem("bvh", path, folder, f"take-{number}-{i}") for i in range(num_items)]
    return items


@pytest.mark.parametrize(
    ("sizes", "expected"),
    [
        ([40, 40, 20, 1], [3, 1]),
        ([40, 150, 40], [1, 1, 1]),
        ([(90, 3), (20, 2), 80], [3, 3]),
        ([(10, 7), 95], [5, 2, 1]),
        ([0] * 12, [5, 5, 2]),
        ([], []),
    ],
)
def test_bytes_of_a_chunk(tmp_path, monkeypatch, sizes, expected):
    """A file that is larger is one of its own; one of many sequences stays together up to their greatest number."""
    monkeypatch.setattr(chunks, "CHUNK_BYTES", 100)
    monkeypatch.setattr(chunks, "CHUNK_ITEMS", 5)
    items = items_of(tmp_path, sizes)
    found = list(chunks_of(items))
    assert [item for chunk in found for item in chunk] == items
    assert [len(chunk) for chunk in found] == expected


@pytest.mark.parametrize(
    ("size", "count", "expected"), [(10, 64, 10), (10, 640, 10), (10, 1280, 20), (100, 1000, 10), (1, 20_000, 60)]
)
def test_large_corpora_have_larger_chunks(tmp_path, monkeypatch, size, count, expected):
    """A 64th of all bytes, but not without bounds; nor of numbers of sequences, here 60."""
    for name, value in (
        ("CHUNK_BYTES", 100),
        ("CHUNK_ITEMS", 50),
        ("MAX_CHUNK_BYTES", 1000),
        ("MAX_CHUNK_ITEMS", 60),
    ):
        monkeypatch.setattr(chunks, name, value)
    monkeypatch.setattr(chunks, "_size", lambda path: size)
    items = [SourceItem("bvh", tmp_path / f"{number}.bvh", tmp_path, str(number)) for number in range(count)]
    found = list(chunks_of(items))
    assert [item for chunk in found for item in chunk] == items
    assert {len(chunk) for chunk in found[:-1]} == {expected}


def folder_of(tmp_path: Path, lengths: list[int]) -> Path:
    folder = tmp_path / "takes"
    folder.mkdir()
    for number, length in enumerate(lengths):
        (folder / f"{number}.bvh").write_text(bvh(length))
    return folder


def test_a_worker_writes_what_has_an_index_and_says_what_it_read(tmp_path):
    folder = folder_of(tmp_path, [300, 5, 7])
    (folder / "1.bvh").write_text("HIERARCHY\n")
    (tmp_path / "motions").mkdir()
    items = [SourceItem("bvh", folder / f"{number}.bvh", folder, f"takes/{number}") for number in (0, 1, 2, 2)]
    numbered = [NumberedItem(item, index) for item, index in zip(items, (4, 5, None, 6), strict=True)]
    read, again = (read_chunk(numbered, tmp_path, ReadOptions()) for _ in range(2))
    assert read.part is not None and again.part is not None and read.part.path != again.part.path
    assert read.part.entry == again.part.entry and read.part.entry.num_rows == 2
    first, broken, known, last = read.outcomes
    assert isinstance(broken, FormatError)
    assert isinstance(first, ReadSequence) and isinstance(known, ReadSequence) and isinstance(last, ReadSequence)
    assert [(each.row["sequence_index"], each.row["part_row"]) for each in (first, last)] == [(4, 0), (6, 1)]
    assert "part_row" not in known.row and known.row["sequence_id"] == "takes/2"
    assert first.skeleton is last.skeleton is known.skeleton


def test_what_is_only_read_leaves_no_file(tmp_path):
    folder = folder_of(tmp_path, [3])
    (tmp_path / "motions").mkdir()
    item = SourceItem("bvh", folder / "0.bvh", folder, "takes/0")
    assert read_chunk([NumberedItem(item, None)], tmp_path, ReadOptions()).part is None
    assert list((tmp_path / "motions").iterdir()) == []


def test_a_file_that_a_worker_does_not_see(tmp_path):
    (tmp_path / "motions").mkdir()
    gone = SourceItem(format="bvh", path=tmp_path / "gone.bvh", root=tmp_path, sequence_id="takes/gone")
    (problem,) = read_chunk([NumberedItem(gone, 0)], tmp_path, ReadOptions()).outcomes
    assert isinstance(problem, FormatError)
    assert problem.reason == "not-visible"
    assert "there is no such file on" in str(problem)


def test_a_store_that_a_worker_does_not_see(tmp_path):
    with pytest.raises(StoreError, match=rf"there is no store {re.escape(str(tmp_path))}/away on .* all machines"):
        read_chunk([], tmp_path / "away", ReadOptions())
    assert not (tmp_path / "away").exists()


@pytest.mark.parametrize("workers", [1, 2])
def test_an_index_is_the_place_among_what_is_new(tmp_path, monkeypatch, workers):
    """Whatever failed and whatever is there already: so a part's bytes do not depend on other parts."""
    monkeypatch.setattr(chunks, "CHUNK_BYTES", 2000)
    folder = folder_of(tmp_path, [20, 30, 40, 50, 60])
    broken = folder / "2.bvh"
    good = broken.read_text()
    broken.write_text("HIERARCHY\n")
    first = ingest([folder], tmp_path / "store", num_workers=workers)
    assert (first.num_stored, len(first.problems)) == (4, 1)
    store = Store.open(tmp_path / "store")
    assert store.sequences["sequence_index"].tolist() == [0, 1, 3, 4]
    assert [store.read(index).num_frames for index in (0, 1, 3, 4)] == [20, 30, 50, 60]
    broken.write_text(good)
    (folder / "5.bvh").write_text(bvh(70))
    second = ingest([folder], tmp_path / "store", num_workers=workers)
    assert (second.num_stored, second.num_already_stored) == (2, 4)
    store = Store.open(tmp_path / "store")
    assert store.sequences["sequence_index"].tolist() == [0, 1, 3, 4, 5, 6]
    assert [store.read(index).num_frames for index in (5, 6)] == [40, 70]
    names = sorted(f"motions/{path.name}" for path in (store.path / "motions").iterdir())
    assert names == list(store.manifest.parts)


KILLED = """
import os, signal, sys
from pathlib import Path
from motionkit.store import chunks
from motionkit.store.ingest import ingest

folder, store, when = map(Path, sys.argv[1:])
marker, finish, read = folder.parent / "died", chunks.PartWriter.finish, chunks.read
chunks.CHUNK_BYTES = 12000

def die_once():
    if not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)

def deadly(item, options):
    if when.name == "reading" and item.path.stem == "1":
        die_once()
    return read(item, options)

def finish_or_die(part):
    written = finish(part)
    if when.name == "written" and part.num_rows > 2:
        die_once()
    return written

chunks.read, chunks.PartWriter.finish = deadly, finish_or_die
if __name__ == "__main__":
    report = ingest([folder], store, num_workers=2)
    assert (report.num_stored, report.problems) == (6, ()), report
"""


@pytest.mark.parametrize("when", ["reading", "written"])
def test_a_worker_that_is_killed_from_outside_changes_nothing(tmp_path, monkeypatch, when):
    """Its chunk is done again, whole; what it wrote is deleted."""
    folder = folder_of(tmp_path, [20, 40, 300, 30, 600, 50])
    monkeypatch.setattr(chunks, "CHUNK_BYTES", 12000)
    ingest([folder], tmp_path / "undisturbed", num_workers=1)
    program = tmp_path / "program.py"
    program.write_text(KILLED)
    subprocess.run([sys.executable, program, folder, tmp_path / "store", when], check=True)
    assert (tmp_path / "died").exists()
    stores = [Store.open(tmp_path / name) for name in ("undisturbed", "store")]
    assert len(stores[0].manifest.parts) == 4
    assert stores[0].fingerprint == stores[1].fingerprint
    names = [sorted(path.name for path in (store.path / "motions").iterdir()) for store in stores]
    assert names[0] == names[1]


@pytest.mark.parametrize("workers", [1, 2])
def test_a_problem_under_stop_leaves_no_part_of_other_chunks(tmp_path, monkeypatch, workers):
    monkeypatch.setattr(chunks, "CHUNK_BYTES", 1)
    folder = folder_of(tmp_path, [20, 30, 40, 50, 60])
    (folder / "3.bvh").write_text("HIERARCHY\n")
    report = ingest([folder], tmp_path / "store", num_workers=workers, on_error="stop")
    assert (report.committed, len(report.problems)) == (False, 1)
    assert list((tmp_path / "store" / "motions").iterdir()) == []


def test_a_part_that_a_store_cannot_take_names_the_file(tmp_path, monkeypatch):
    """As where the disk is full: a worker's fault is not its file's."""

    def full(*arguments, **options):
        raise OSError(28, "No space left on device")

    folder = folder_of(tmp_path, [20])
    monkeypatch.setattr("pyarrow.parquet.ParquetWriter.write_table", full)
    with pytest.raises(
        StoreError, match=r"cannot be written .*No space left .*part-00000-.{8}\.parquet\.new.*as it was"
    ):
        ingest([folder], tmp_path / "store", num_workers=1)
    assert list((tmp_path / "store" / "motions").iterdir()) == []
