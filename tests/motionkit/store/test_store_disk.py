"""A disk that is full, fails or has no locks: what is committed stays or is there, and the error says which."""

import errno
import itertools
import os
import re
import resource
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from motionkit.core.errors import StoreError
from motionkit.store import Store, StoreWriter
from motionkit.store.cache import open_cache
from motionkit.store.ingest import ingest
from motionkit.store.life.rewrite import compact, merge, remove
from motionkit.store.life.splits import split
from motionkit.store.validate import faults
from tests.motionkit.store.test_store_commit import append_two_parts, leftovers


@pytest.mark.parametrize("most_bytes", [2, 3000], ids=["not even a first word", "part of a page"])
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
    with StoreWriter.append(small_store) as again:  # the lock is free, with the writer that failed still there
        again.add(make_motion("new-0"))
    assert "new-0" in Store.open(small_store).sequences_table["sequence_id"].to_pylist()


FULL = textwrap.dedent(
    """
    import resource, signal, sys
    from pathlib import Path
    from motionkit.core.errors import MotionkitError
    from motionkit.store.life.rewrite import remove
    from motionkit.store.life.rewrite import compact, merge

    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    store, what, most = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
    try:
        {"remove": lambda: remove(store, ["take-3"]), "merge": lambda: merge(store.with_name("out"), [store])}[what]()
    except OSError as error:
        print(error.filename)
    """
)


@pytest.mark.parametrize(
    ("what", "most_bytes", "name"),
    [
        ("remove", 0, r"store/\.writer\.lock"),
        ("remove", 1000, r"store/sequences\.parquet\.new"),
        ("merge", 0, r"out/\.writer\.lock"),
        ("merge", 10_000, r"out/segments/part-00000\.parquet\.new"),
    ],
)
def test_no_space_left_names_the_file(small_store, what, most_bytes, name):
    before = Store.open(small_store).fingerprint
    arguments = [sys.executable, "-c", FULL, str(small_store), what, str(most_bytes)]
    said = subprocess.run(arguments, check=True, stdout=subprocess.PIPE, text=True).stdout
    assert re.search(rf"{name}\n$", said), said
    assert Store.open(small_store).fingerprint == before
    assert leftovers(small_store) == []


def _ingest_more(store: Path) -> None:
    ingest([store.with_name("more.npz")], store)


CHANGES = {
    "ingest": _ingest_more,
    "append": lambda store: merge(store, [store.with_name("other")]),
    "remove": lambda store: remove(store, ["take-3"]),
    "compact": lambda store: compact(store),
    "split": lambda store: split(store, {"train": 0.5, "val": 0.5}, by="sequence_id"),
}


@pytest.mark.parametrize(("change", "call"), [*itertools.product(CHANGES, ("fsync", "replace")), ("compact", "unlink")])
def test_a_disk_that_fails_at_any_call_is_reported_with_what_is_committed(
    small_store, make_motion, tmp_path, monkeypatch, change, call
):
    append_two_parts(small_store, make_motion)
    remove(small_store, ["take-1"])
    with StoreWriter.create(tmp_path / "other") as writer:
        writer.add(make_motion("other"))
    make_motion("more").save(tmp_path / "more.npz")
    open_cache(Store.open(small_store))
    original, whole, failures = getattr(os, call), tmp_path / "whole", 0
    small_store.rename(whole)
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
                CHANGES[change](store)
                failed = None
            except (StoreError, OSError) as error:
                failed = error
        if next(calls) <= fails_at:
            break
        assert failed is not None
        failures += 1
        committed = Store.open(store).fingerprint != before
        assert ("committed" in str(failed)) == committed
        assert ("as it was" in str(failed)) == (change == "ingest" and not committed)
        assert list(faults(store)) == []
        shutil.rmtree(store)
    assert failures > 0


WITHOUT = textwrap.dedent(
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
    arguments = [sys.executable, "-c", WITHOUT, missing, str(small_store), str(tmp_path / "new")]
    done = subprocess.run(arguments, check=True, stderr=subprocess.PIPE, text=True)
    assert str(tmp_path / "new") in done.stderr  # a warning names the store
    assert Store.open(tmp_path / "new").num_sequences == 1
