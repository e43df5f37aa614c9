"""Symbolic links in a store: nothing is written or deleted through them."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from motionkit.core.errors import MotionkitError
from motionkit.store import Store, StoreWriter
from motionkit.store.life.rewrite import compact, merge, remove
from motionkit.store.life.splits import split
from motionkit.store.reports.summary import summarise
from motionkit.store.validate import faults

PART = "segments/part-00000.parquet"


def append(store: Path, make_motion: Callable) -> None:
    with StoreWriter.append(store) as writer:
        writer.add(make_motion("new"))


def overwrite(store: Path, make_motion: Callable) -> None:
    with StoreWriter.create(store, overwrite=True) as writer:
        writer.add(make_motion("new"))


CHANGES: dict[str, Callable[[Path, Callable], object]] = {
    "append": append,
    "overwrite": overwrite,
    "remove": lambda store, make_motion: remove(store, where="true"),
    "compact": lambda store, make_motion: compact(store),
    "split": lambda store, make_motion: split(store, by="sequence_id"),
    "merge": lambda store, make_motion: merge(store, [store.parent / "other"]),
}


@pytest.fixture
def other(small_store: Path) -> Path:
    """Another store, beside the one that is changed."""
    shutil.copytree(small_store, small_store.parent / "other")
    return small_store.parent / "other"


def content_of(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.mark.parametrize(
    "name",
    [
        *("sequences.parquet", "skeletons.parquet", "manifest.json", PART),
        *("sequences.parquet.new", "skeletons.parquet.new", "manifest.json.new"),
        *("segments/part-00001.parquet", "segments/part-00001.parquet.new"),
        "segments/part-00001-0123abcd.parquet.new",
    ],
)
@pytest.mark.parametrize("change", CHANGES)
def test_files_that_are_links_are_replaced_and_not_written_through(small_store, other, make_motion, name, change):
    theirs = shutil.copytree(small_store, small_store.parent / "theirs")
    append(other, make_motion)  # what `merge` adds
    before = content_of(theirs)
    target = theirs / name if (theirs / name).exists() else theirs / "sequences.parquet"
    (small_store / name).unlink(missing_ok=True)
    (small_store / name).symlink_to(target)
    CHANGES[change](small_store, make_motion)
    assert content_of(theirs) == before
    assert list(faults(small_store)) == []


def test_a_pending_table_that_is_a_link_is_not_taken_for_the_committed_one(small_store, other, make_motion):
    before = content_of(other)
    (small_store / "sequences.parquet").rename(small_store.parent / "table")
    (small_store / "sequences.parquet.new").symlink_to(small_store.parent / "table")
    assert Store.open(small_store).num_sequences == 6
    with pytest.raises(MotionkitError, match="validate"):
        append(small_store, make_motion)
    assert (small_store.parent / "table").read_bytes() == before["sequences.parquet"]


@pytest.mark.parametrize("change", CHANGES)
def test_a_store_may_be_reached_through_a_link(small_store, other, make_motion, change):
    link = small_store.parent / "link"
    link.symlink_to(small_store)
    CHANGES[change](link, make_motion)
    assert list(faults(link)) == []
    assert link.is_symlink()


def test_files_of_a_users_own_among_the_parts_stay(small_store, make_motion):
    own = {"part-00000.parquet.bak", "part-0.parquet", "part-00007.parquet.new.txt", "notes.txt"}
    own |= {"part-00001-my-copy.parquet.new", "part-00001-0123abcd.parquet"}
    for name in own:
        (small_store / "segments" / name).write_text("dear")
    append(small_store, make_motion)
    compact(small_store)
    left = {path.name for path in (small_store / "segments").iterdir()}
    assert left >= own


def test_the_size_of_a_cache_behind_a_link_is_not_counted(small_store):
    (small_store / "cache").symlink_to("/")
    assert summarise(Store.open(small_store)).cache_bytes == 0
