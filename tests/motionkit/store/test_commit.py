"""A change that fails or dies at whatever moment leaves a store that opens: the previous one or the new one.

On a full, failing or lockless disk too; and nothing is written or deleted through symbolic links.
"""

import errno
import itertools
import json
import os
import resource
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path

import pytest

from motionkit.cli import store as commands
from motionkit.core import files
from motionkit.core.errors import BusyError, StoreError, UsageError
from motionkit.store import Store, StoreWriter
from motionkit.store.commit import LOCK_FILE
from motionkit.store.life import compact, merge, remove, split
from motionkit.store.validate import faults
from tests.helpers.signed_again import sign

PART = "motions/part-00000.parquet"

# The renames of one append that fills two parts: part, part, manifest (the commit), sequences, skeletons.
NUM_RENAMES, COMMIT = 5, 2


def leftovers(store: Path) -> list[str]:
    named = {"manifest.json", *json.loads((store / "manifest.json").read_text())["files"]}
    return sorted({str(path.relative_to(store)) for path in store.rglob("*") if path.is_file()} - named - {LOCK_FILE})


def append_two_parts(store: Path, make_motion) -> None:
    with StoreWriter.append(store, part_bytes=1) as writer:
        for i in range(18):
            writer.add(make_motion(f"new-{i}", 150))


@pytest.mark.parametrize("fails_at", range(NUM_RENAMES))
@pytest.mark.parametrize("after", [False, True], ids=["before", "after"])
def test_a_fault_at_any_rename(small_store, make_motion, monkeypatch, fails_at, after):
    previous = Store.open(small_store).fingerprint
    rename, calls = files.replace, []

    def failing(source: Path, target: Path) -> None:
        calls.append(target.name)
        if len(calls) == fails_at + 1:
            if after:
                rename(source, target)
            raise OSError(28, "No space left on device")
        rename(source, target)

    monkeypatch.setattr(files, "replace", failing)
    committed = fails_at > COMMIT or (fails_at == COMMIT and after)
    with pytest.raises(StoreError if committed else OSError, match="No space"):
        append_two_parts(small_store, make_motion)
    monkeypatch.undo()
    store = Store.open(small_store)
    assert (store.fingerprint != previous) == committed
    assert store.num_sequences == (24 if committed else 6)
    assert len(list(store.read_many(range(store.num_sequences)))) == store.num_sequences
    with StoreWriter.append(small_store) as writer:
        writer.add(make_motion("later"))
    assert leftovers(small_store) == []
    assert Store.open(small_store).num_sequences == store.num_sequences + 1
    assert calls[COMMIT] == "manifest.json" if len(calls) > COMMIT else not committed


CHILD = textwrap.dedent(
    """
    import os, signal, sys
    from fractions import Fraction
    from pathlib import Path
    import numpy as np
    from motionkit.core.motion import Motion
    from motionkit.core.skeleton import SMPL22
    from motionkit.core import files
    from motionkit.store import StoreWriter
    from motionkit.core.timegrid import TimeGrid

    store, moment = Path(sys.argv[1]), sys.argv[2]
    def die(): os.kill(os.getpid(), signal.SIGKILL)
    if moment.startswith("rename"):
        rename, left = files.replace, [int(moment.removeprefix("rename"))]
        def replace(source, target):
            if left[0] == 0: die()
            left[0] -= 1
            rename(source, target)
        files.replace = replace
    with StoreWriter.append(store, part_bytes=1) as writer:
        for i in range(18):
            if moment == f"motion{i}": die()
            frames = np.zeros((150, 22, 3), np.float32)
            writer.add(Motion(frames, SMPL22, TimeGrid(Fraction(30), 150), sequence_id=f"killed-{i}"))
    """
)


@pytest.mark.parametrize("moment", ["motion0", "motion17", "rename0", "rename1", "rename2", "rename3", "rename4"])
def test_a_killed_writer(small_store, make_motion, moment):
    """SIGKILL: no handler runs, no buffer is written."""
    previous = Store.open(small_store).fingerprint
    child = subprocess.run([sys.executable, "-c", CHILD, str(small_store), moment], check=False)
    assert child.returncode == -9
    store = Store.open(small_store)
    committed = moment in ("rename3", "rename4")
    assert (store.fingerprint == previous) != committed
    assert len(list(store.read_many(range(store.num_sequences)))) == (24 if committed else 6)
    with StoreWriter.append(small_store) as writer:
        writer.add(make_motion("later"))
    assert leftovers(small_store) == []
    assert Store.open(small_store).num_sequences == store.num_sequences + 1


REWRITER = textwrap.dedent(
    """
    import os, signal, sys
    from pathlib import Path
    from motionkit.core import files
    from motionkit.store.life import compact, remove

    store, what, left = Path(sys.argv[1]), sys.argv[2], [int(sys.argv[3])]
    rename = files.replace
    def replace(source, target):
        if left[0] == 0: os.kill(os.getpid(), signal.SIGKILL)
        left[0] -= 1
        rename(source, target)
    files.replace = replace
    {"remove": lambda: remove(store, ["take-3"]), "compact": lambda: compact(store)}[what]()
    """
)


# The renames: parts, then the manifest (the commit), then the tables.
@pytest.mark.parametrize(
    ("what", "moment", "committed"),
    [
        *(("remove", moment, moment == 1) for moment in range(2)),
        *(("compact", moment, moment > 1) for moment in range(4)),
    ],
)
def test_a_killed_change(small_store, make_motion, what, moment, committed):
    """A removal or compaction that dies leaves the state before it or after it, and nothing for long."""
    if what == "compact":
        append_two_parts(small_store, make_motion)
    before = Store.open(small_store)
    arguments = [sys.executable, "-c", REWRITER, str(small_store), what, str(moment)]
    assert subprocess.run(arguments, check=False).returncode == -9
    store = Store.open(small_store)
    assert (store.fingerprint != before.fingerprint) == committed
    expected = [
        name for name in before.sequences["sequence_id"] if not (committed and what == "remove" and name == "take-3")
    ]
    assert [motion.sequence_id for motion in store.read_many(store.select())] == expected
    assert all("a caption lasts" in fault for fault in faults(small_store))
    with StoreWriter.append(small_store) as writer:
        writer.add(make_motion("later"))
    assert leftovers(small_store) == []
    assert all("a caption lasts" in fault for fault in faults(small_store))


FINISHING = {
    "compact": lambda store: compact(store),
    "remove": lambda store: remove(store, where="false"),
    "split": lambda store: split(store, {"train": 1.0}),
    "append": lambda store: StoreWriter.append(store).__enter__().__exit__(None, None, None),
}


@pytest.mark.parametrize("moment", [2, 3], ids=["sequences", "skeletons"])
def test_what_a_killed_compaction_left_is_deleted_by_whoever_writes_next(small_store, make_motion, moment):
    """It has committed, so the store is compact; the old parts hold what was removed, and have to go."""
    append_two_parts(small_store, make_motion)
    remove(small_store, ["take-3"])
    arguments = [sys.executable, "-c", REWRITER, str(small_store), "compact", str(moment)]
    assert subprocess.run(arguments, check=False).returncode == -9
    old = {f"motions/part-0000{number}.parquet" for number in range(3)}
    assert set(leftovers(small_store)) > old
    assert Store.open(small_store).num_sequences == 23
    for name, finish in FINISHING.items():
        store = shutil.copytree(small_store, small_store.with_name(name))
        finish(store)
        assert (leftovers(store), list(faults(store))) == ([], []), name
        assert not compact(store), name


def test_an_exception_in_the_block_leaves_everything_as_it_was(small_store, make_motion):
    before = {path: path.read_bytes() for path in small_store.rglob("*") if path.is_file()}
    with pytest.raises(RuntimeError), StoreWriter.append(small_store, part_bytes=1) as writer:
        for i in range(18):
            writer.add(make_motion(f"new-{i}", 150))
        raise RuntimeError
    after = {path: path.read_bytes() for path in small_store.rglob("*") if path.is_file()}
    before.pop(small_store / LOCK_FILE), after.pop(small_store / LOCK_FILE)
    assert after == before


def test_a_failed_creation_can_be_tried_again(tmp_path, make_motion):
    with pytest.raises(RuntimeError), StoreWriter.create(tmp_path / "store") as writer:
        writer.add(make_motion("a"))
        raise RuntimeError
    with pytest.raises(StoreError, match="there is no store"):
        Store.open(tmp_path / "store")
    with StoreWriter.create(tmp_path / "store") as writer:
        writer.add(make_motion("a"))
    assert Store.open(tmp_path / "store").num_sequences == 1


def test_two_writers(small_store, make_motion):
    with StoreWriter.append(small_store) as writer:
        with pytest.raises(BusyError, match="another process is writing"):
            StoreWriter.append(small_store).__enter__()
        writer.add(make_motion("first"))
    with StoreWriter.append(small_store) as writer:
        writer.add(make_motion("second"))
    assert Store.open(small_store).num_sequences == 8


WRITER = textwrap.dedent(
    """
    import sys
    from fractions import Fraction
    from pathlib import Path
    import numpy as np
    from motionkit.core.errors import BusyError
    from motionkit.core.motion import Motion
    from motionkit.core.skeleton import SMPL22
    from motionkit.store import StoreWriter
    from motionkit.core.timegrid import TimeGrid

    store, name = Path(sys.argv[1]), sys.argv[2]
    frames = np.zeros((3, 22, 3), np.float32)
    for number in range(8):
        while True:
            try:
                with StoreWriter.append(store) as writer:
                    writer.add(Motion(frames, SMPL22, TimeGrid(Fraction(30), 3), sequence_id=f"{name}-{number}"))
                break
            except BusyError:
                pass
    """
)


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
    assert all("a caption lasts" in fault for fault in faults(small_store))
    assert leftovers(small_store) == []


HOLDER = textwrap.dedent(
    """
    import sys, time
    from motionkit.store import StoreWriter
    with StoreWriter.append(sys.argv[1]):
        print("holding", flush=True)
        time.sleep(600)
    """
)


def test_the_lock_of_a_killed_writer_is_free(small_store, make_motion):
    """And as long as it lives, every change is refused."""
    arguments = [sys.executable, "-c", HOLDER, str(small_store)]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None and holder.stdout.readline() == "holding\n"
        for change in (lambda: remove(small_store, ["take-3"]), lambda: append_two_parts(small_store, make_motion)):
            with pytest.raises(BusyError, match="another process is writing"):
                change()
        holder.kill()
    assert remove(small_store, ["take-3"]) == ("take-3",)


def test_a_table_that_gets_its_name_while_it_is_looked_for_is_found(small_store, monkeypatch):
    table, pending = small_store / "sequences.parquet", small_store / "sequences.parquet.new"
    content = table.read_bytes()
    pending.write_bytes(content)
    table.write_bytes(content[:-1] + b"0")  # the table of the commit before
    read = Path.read_bytes

    def read_slowly(path: Path) -> bytes:
        found = read(path)
        if pending.exists():
            pending.replace(table)
        return found

    monkeypatch.setattr(Path, "read_bytes", read_slowly)
    assert all("a caption lasts" in fault for fault in faults(small_store))


def test_create_and_append_say_what_is_wrong(small_store, tmp_path, make_motion):
    with pytest.raises(StoreError, match="already is a store"), StoreWriter.create(small_store):
        pass
    with pytest.raises(StoreError, match="motionkit ingest"), StoreWriter.append(tmp_path / "nowhere"):
        pass
    assert not (tmp_path / "nowhere").exists()
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "cat.jpg").write_bytes(b"")
    with (
        pytest.raises(StoreError, match=r"not a store and not empty .*cat\.jpg"),
        StoreWriter.create(tmp_path / "photos"),
    ):
        pass
    with pytest.raises(StoreError, match="is a file"), StoreWriter.create(tmp_path / "photos" / "cat.jpg"):
        pass


def test_a_part_that_is_there_is_not_written_over(small_store, make_motion, monkeypatch):
    """`next.part` of a manifest with one bit flipped used to be believed."""
    before = (small_store / PART).read_bytes()
    with (
        pytest.raises(StoreError, match=r"part-00000\.parquet is there already"),
        StoreWriter.append(small_store) as writer,
    ):
        monkeypatch.setattr(writer, "_next_part", 0)
        writer.add(make_motion("later"))
    assert (small_store / PART).read_bytes() == before


def test_parts_are_kept_while_one_that_the_manifest_names_is_missing(small_store, make_motion):
    """A name may be wrong by one bit: what the manifest does not name may be what it means."""

    def rename(document):
        document["files"]["motions/part-00002.parquet"] = document["files"].pop(PART)
        document["next"]["part"] = 3

    sign(small_store, rename)
    with StoreWriter.append(small_store) as writer:
        writer.add(make_motion("later"))
    assert (small_store / PART).exists()


def append(store: Path, make_motion: Callable) -> None:
    with StoreWriter.append(store) as writer:
        writer.add(make_motion("new"))


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
    append(small_store.with_name("other"), make_motion)
    remove(small_store, ["take-0"])
    return small_store.with_name("other")


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
@pytest.mark.parametrize("change", CHANGES)
def test_files_that_are_links_are_replaced_and_not_written_through(small_store, other, make_motion, name, change):
    theirs = shutil.copytree(small_store, small_store.with_name("theirs"))
    before = content_of(theirs)
    (small_store / name).unlink(missing_ok=True)
    (small_store / name).symlink_to(theirs / name if (theirs / name).exists() else theirs / "sequences.parquet")
    link = small_store.with_name("link")
    link.symlink_to(small_store)  # a store may be reached through a link
    CHANGES[change](link, make_motion)
    assert content_of(theirs) == before
    assert list(faults(link)) == [] and link.is_symlink()


def test_a_pending_table_that_is_a_link_is_not_the_committed_one(small_store, make_motion):
    table = (small_store / "sequences.parquet").rename(small_store.with_name("table"))
    content = table.read_bytes()
    (small_store / "sequences.parquet.new").symlink_to(table)
    assert Store.open(small_store).num_sequences == 6
    with pytest.raises(StoreError, match="validate"):
        append(small_store, make_motion)
    assert table.read_bytes() == content


def test_files_of_a_users_own_among_the_parts_stay(small_store, make_motion):
    own = {"part-00000.parquet.bak", "part-0.parquet", "part-00007.parquet.new.txt", "notes.txt"}
    own |= {"part-00001-my-copy.parquet.new"}
    for name in own:
        (small_store / "motions" / name).write_text("dear")
    append(small_store, make_motion)
    compact(small_store)
    assert {path.name for path in (small_store / "motions").iterdir()} >= own


@pytest.mark.parametrize("most_bytes", [2, 3000], ids=["not even a first word", "a first page"])
def test_a_full_disk_leaves_everything_as_it_was(small_store, make_motion, most_bytes):
    previous = Store.open(small_store).fingerprint
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        with pytest.raises(OSError, match="File too large"), StoreWriter.append(small_store) as writer:
            resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, limits[1]))
            for number in range(20):
                writer.add(make_motion(f"new-{number}"))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert Store.open(small_store).fingerprint == previous
    assert leftovers(small_store) == []
    append(small_store, make_motion)  # the lock is free, with the writer that failed still there
    assert "new" in Store.open(small_store)


@pytest.mark.parametrize(
    ("change", "call"),
    [
        *itertools.product(("append", "remove", "compact", "merge", "split"), ("fsync", "replace")),
        ("compact", "unlink"),
    ],
)
def test_a_disk_that_fails_at_any_call_is_reported_with_what_is_committed(
    small_store, other, make_motion, tmp_path, monkeypatch, change, call
):
    append_two_parts(small_store, make_motion)
    original, whole, failures = getattr(os, call), small_store.rename(tmp_path / "whole"), 0
    before = Store.open(whole).fingerprint
    for fails_at in range(100):
        store = Path(shutil.copytree(whole, tmp_path / "store"))
        calls = itertools.count()

        def failing(*arguments, fails_at=fails_at, calls=calls, **options):
            if next(calls) == fails_at:
                raise OSError(errno.EIO, os.strerror(errno.EIO))
            return original(*arguments, **options)

        with monkeypatch.context() as patch:
            patch.setattr(os, call, failing)
            try:
                CHANGES[change](store, make_motion)
                failed = None
            except (StoreError, OSError) as error:
                failed = error
        if next(calls) <= fails_at:
            break
        assert failed is not None
        failures += 1
        assert ("committed" in str(failed)) == (Store.open(store).fingerprint != before)
        assert list(faults(store)) == []
        shutil.rmtree(store)
    assert failures > 0


WITHOUT_LOCKS = textwrap.dedent(
    """
    import sys
    if sys.argv[1] == "module":
        sys.modules["fcntl"] = None
    else:
        import errno, fcntl
        def flock(descriptor, operation): raise OSError(errno.ENOSYS, "Function not implemented")
        fcntl.flock = flock

    import motionkit as mk
    first = mk.Store.open(sys.argv[2]).read(0)
    with mk.StoreWriter.create(sys.argv[3]) as writer:
        writer.add(first)
    """
)


@pytest.mark.parametrize("missing", ["module", "call"])
def test_a_store_is_written_where_there_are_no_locks(small_store, tmp_path, missing):
    arguments = [sys.executable, "-c", WITHOUT_LOCKS, missing, str(small_store), str(tmp_path / "new")]
    done = subprocess.run(arguments, check=True, stderr=subprocess.PIPE, text=True)
    assert "lock" in done.stderr  # a warning
    assert Store.open(tmp_path / "new").num_sequences == 1


def test_a_command_that_finds_nothing_left_to_remove_finishes_what_a_killed_one_left(small_store):
    arguments = [sys.executable, "-c", REWRITER, str(small_store), "remove", "1"]
    assert subprocess.run(arguments, check=False).returncode == -9
    assert leftovers(small_store) != []
    with pytest.raises(UsageError, match="no sequence of"):
        commands.remove(where="sequence_id = 'take-3'", store=small_store)
    assert leftovers(small_store) == []
