"""The drill's crowd: what its readers and writers find wrong, and that ours find nothing."""

import time
from pathlib import Path

import numpy as np

from benchmarks.trust import load, store_users
from benchmarks.trust.store_users import Log, batch_ids, log_of, motion_of
from motionkit.store import Store, StoreWriter
from motionkit.store.life import remove

CROWD_SECONDS = 3.0


def made(path: Path) -> Path:
    store_users.create(path / "store")
    return path / "store"


def test_whoever_reads_notices_half_a_batch_and_other_frames(tmp_path: Path) -> None:
    store, generator = made(tmp_path), np.random.default_rng(0)
    assert store_users.looked_at(Store.open(store), generator) == []
    remove(store, batch_ids(store_users.BASE)[:1])
    assert store_users.looked_at(Store.open(store), generator) == [f"of the batch {store_users.BASE} there are 3"]
    with StoreWriter.append(store) as writer:
        other = motion_of("else")
        writer.add(type(other)(other.joint_positions, other.skeleton, other.timegrid, sequence_id="one-0-1/0"))
    assert "one-0-1/0 has other frames" in store_users.looked_at(Store.open(store), generator)


def test_what_writers_said_they_had_done_must_be_there_in_the_end(tmp_path: Path) -> None:
    store = made(tmp_path)
    counts = store_users.write(store, "writer0", time.time(), seed=0)["counts"]
    assert counts == {"append": 1}
    assert store_users.final_problems(store, ["writer0"]) == []
    Log(log_of(store, "writer0")).note("done", "append", "writer0-7-1")
    assert store_users.final_problems(store, ["writer0"]) == ["lost: writer0-7-1/0"]


def test_a_killed_writer_finds_out_what_became_of_its_last_change(tmp_path: Path) -> None:
    store = made(tmp_path)
    log = Log(log_of(store, "writer0"))
    log.note("begin", "append", "writer0-1-2")
    assert store_users.settle(store, log) == set()
    log.note("begin", "append", "writer0-2-2")
    store_users.change(store, "append", "writer0-2-2")
    assert store_users.settle(store, log) == {"writer0-2-2"}
    log.note("begin", "remove", "writer0-2-2")
    store_users.change(store, "remove", "writer0-2-2")
    assert store_users.settle(store, log) == set()


def test_a_crowd_loses_nothing(tmp_path: Path) -> None:
    """A slice of `python -m benchmarks.trust load`."""
    case = load.crowd(0, CROWD_SECONDS, tmp_path / "crowd", num_writers=2, num_readers=2)
    assert case.failures == ()
    assert case.figures["changes"] and case.figures["read"]
