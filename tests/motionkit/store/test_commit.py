"""A change that fails or dies at whatever moment leaves a store that opens: the previous one or the new one.

On a full or failing disk too; and nothing is written or deleted through symbolic links.
"""

import itertools
import json
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from motionkit.core.errors import StoreError
from motionkit.store import Store, StoreWriter
from motionkit.store.commit import LOCK_FILE
from motionkit.store.life import compact, merge, remove, split
from motionkit.store.validate import faults
from tests.helpers.killing import killed_before

PART = "motions/part-00000.parquet"


def leftovers(store: Path) -> list[str]:
    named = {"manifest.json", *json.loads((store / "manifest.json").read_text())["files"]}
    return sorted({str(path.relative_to(store)) for path in store.rglob("*") if path.is_file()} - named - {LOCK_FILE})


def append(store: Path, make_motion: Callable) -> None:
    with StoreWriter.append(store, part_bytes=1) as writer:  # two parts
        for i in range(18):
            writer.add(make_motion(f"new-{i}", 150))


def overwrite(store: Path, make_motion: Callable) -> None:
    with StoreWriter.create(store, overwrite=True) as writer:
        writer.add(make_motion("new"))


CHANGES: dict[str, Callable[[Path, Callable], object]] = {
    "append": append,
    "overwrite": overwrite,
    "remove": lambda store, make_motion: remove(store, ["take-3"]),
    "compact": lambda store, make_motion: compact(store),
    "merge": lambda store, make_motion: merge(store, [store.with_name("other")]),
    "split": lambda store, make_motion: split(store, {"train": 0.5, "val": 0.5}, by="sequence_id"),
}


@pytest.fixture
def other(small_store: Path, make_motion: Callable) -> Path:
    """Another store, beside the one that is changed, with one sequence more."""
    shutil.copytree(small_store, small_store.with_name("other"))
    with StoreWriter.append(small_store.with_name("other")) as writer:
        writer.add(make_motion("other"))
    remove(small_store, ["take-0"])
    return small_store.with_name("other")


@pytest.mark.parametrize("change", ["append", "overwrite", "remove", "compact"])
def test_a_change_that_is_killed_at_any_step(small_store, other, make_motion, tmp_path, change):
    """SIGKILL: the store is the one before or the one after, and the next writer deletes what was left."""
    whole = small_store.rename(tmp_path / "whole")
    undisturbed = shutil.copytree(whole, tmp_path / "undisturbed" / "store")
    shutil.copytree(other, undisturbed.with_name("other"))
    CHANGES[change](undisturbed, make_motion)
    states, reached = [Store.open(whole).fingerprint, Store.open(undisturbed).fingerprint], []
    for step in itertools.count():
        store = shutil.copytree(whole, tmp_path / "store")
        if not killed_before(step, store, partial(CHANGES[change], store, make_motion)):
            break
        opened = Store.open(store)
        reached.append(states.index(opened.fingerprint))
        assert len(list(opened.read_many(opened.select()))) == opened.num_sequences
        assert list(faults(store)) == []
        with StoreWriter.append(store):
            pass
        assert (leftovers(store), list(faults(store))) == ([], [])
        shutil.rmtree(store)
    assert len(reached) > 4 and reached == sorted(reached) and set(reached) == {0, 1}


def test_an_exception_in_the_block_leaves_everything_as_it_was(small_store, tmp_path, make_motion):
    before = content_of(small_store)
    with pytest.raises(RuntimeError), StoreWriter.append(small_store, part_bytes=1) as writer:
        for i in range(18):
            writer.add(make_motion(f"new-{i}", 150))
        raise RuntimeError
    assert content_of(small_store) == before
    with pytest.raises(RuntimeError), StoreWriter.create(tmp_path / "new") as writer:
        writer.add(make_motion("a"))
        raise RuntimeError
    with pytest.raises(StoreError, match="new"):
        Store.open(tmp_path / "new")
    with StoreWriter.create(tmp_path / "new") as writer:
        writer.add(make_motion("a"))
    assert Store.open(tmp_path / "new").num_sequences == 1


WRITER = """
import sys
from dataclasses import replace
import numpy as np
import motionkit as mk
from motionkit.core.errors import BusyError

for number in range(8):
    motion = mk.Motion.from_joints(np.zeros((3, 22, 3), np.float32), fps=30)
    motion = replace(motion, sequence_id=f"{sys.argv[2]}-{number}")
    while True:
        try:
            with mk.StoreWriter.append(sys.argv[1]) as writer:
                writer.add(motion)
            break
        except BusyError:
            pass
"""


def test_two_processes_that_write_at_once_lose_nothing(small_store):
    writers = [subprocess.Popen([sys.executable, "-c", WRITER, str(small_store), name]) for name in ("left", "right")]
    while any(writer.poll() is None for writer in writers):
        store = Store.open(small_store)
        assert len(store.sequences_table) == store.num_sequences
        store.read(store.num_sequences - 1)
    assert [writer.returncode for writer in writers] == [0, 0]
    ids = Store.open(small_store).sequences["sequence_id"].tolist()
    for name in ("left", "right"):
        assert [each for each in ids if each.startswith(name)] == [f"{name}-{number}" for number in range(8)]
    assert len(ids) == 6 + 16
    assert (leftovers(small_store), list(faults(small_store))) == ([], [])


def test_create_and_append_say_what_is_wrong(small_store, tmp_path, make_motion):
    photo = tmp_path / "photos" / "cat.jpg"
    photo.parent.mkdir()
    photo.write_bytes(b"")
    for create, path, says in (
        (StoreWriter.create, small_store, "store"),
        (StoreWriter.append, tmp_path / "nowhere", "nowhere"),
        (StoreWriter.create, photo.parent, "photos .*cat.jpg"),
        (StoreWriter.create, photo, "cat.jpg"),
    ):
        with pytest.raises(StoreError, match=says), create(path):
            pass
    assert not (tmp_path / "nowhere").exists()


def content_of(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_nothing_is_deleted_behind_a_link(small_store, other, make_motion):
    before = content_of(other)
    shutil.rmtree(small_store / "motions")
    (small_store / "motions").symlink_to(other / "motions")
    remove(small_store, ["take-3"])
    assert content_of(other) == before


@pytest.mark.parametrize(
    "name",
    ["sequences.parquet", "manifest.json", PART, "skeletons.parquet.new", "motions/part-00001-0123abcd.parquet.new"],
)
def test_files_that_are_links_are_replaced_and_not_written_through(small_store, other, make_motion, name):
    theirs = shutil.copytree(small_store, small_store.with_name("theirs"))
    before = content_of(theirs)
    (small_store / name).unlink(missing_ok=True)
    (small_store / name).symlink_to(theirs / name if (theirs / name).exists() else theirs / "sequences.parquet")
    link = small_store.with_name("link")
    link.symlink_to(small_store)  # a store may be reached through a link
    for change in ("append", "merge", "compact"):
        CHANGES[change](link, make_motion)
        assert content_of(theirs) == before
        assert list(faults(link)) == [] and link.is_symlink()


def test_files_of_a_users_own_among_the_parts_stay(small_store, make_motion):
    own = {"part-00000.parquet.bak", "part-0.parquet", "notes.txt", "part-00001-my-copy.parquet.new"}
    for name in own:
        (small_store / "motions" / name).write_text("dear")
    append(small_store, make_motion)
    compact(small_store)
    assert {path.name for path in (small_store / "motions").iterdir()} >= own


def test_a_full_disk_leaves_everything_as_it_was(small_store, make_motion):
    previous = Store.open(small_store).fingerprint
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        with pytest.raises(OSError), StoreWriter.append(small_store) as writer:
            resource.setrlimit(resource.RLIMIT_FSIZE, (3000, limits[1]))
            for number in range(20):
                writer.add(make_motion(f"new-{number}"))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert Store.open(small_store).fingerprint == previous
    assert leftovers(small_store) == []
    append(small_store, make_motion)  # the lock is free, with the writer that failed still there
    assert "new-0" in Store.open(small_store)
