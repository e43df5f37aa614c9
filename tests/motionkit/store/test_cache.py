"""The training cache holds the store's frames bit by bit, follows the store, and is rebuilt when damaged."""

import itertools
import pickle
import shutil
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from motionkit.core.errors import DamagedFileError, UsageError
from motionkit.core.progress import Progress
from motionkit.core.skeletons.mapping import map_joints
from motionkit.store.cache import PositionCache, open_cache
from motionkit.store.life import compact
from tests.helpers.killing import killed_before

CHAIN = mk.Skeleton("chain", ("a", "b", "c"), (-1, 0, 1), np.eye(3, dtype=np.float32))


@pytest.fixture
def mixed_store(tmp_path: Path, make_motion) -> Path:
    """Motions on three skeletons, one of which has no body."""
    with mk.StoreWriter.create(tmp_path / "mixed") as writer:
        writer.add(make_motion("smpl", 50))
        writer.add(make_motion("chain", 60, skeleton=CHAIN))
        writer.add(make_motion("long", 700, fps=Fraction(30000, 1001), split="test"))
    return tmp_path / "mixed"


def change(store: Path, make_motion) -> None:
    with mk.StoreWriter.append(store) as writer:
        writer.add(make_motion("new", 33))


def folders(store: Path) -> list[Path]:
    return [path for path in (store / "cache").iterdir() if path.is_dir()]


def sums(built: PositionCache) -> np.ndarray:
    """Rows derived from a cache, as trainings compute them."""
    rows = built.derived_rows(
        "sums", 1, lambda: (built.sequence_positions(n).sum((1, 2))[:, None] for n in range(built.num_sequences))
    )
    return rows[np.arange(len(rows))]


def test_the_cache_holds_the_frames_of_the_store(small_store):
    reports: list[Progress] = []
    store = mk.Store.open(small_store, on_progress=reports.append)
    built = open_cache(store)
    assert [report.done for report in reports] == [*range(7), 6]
    assert (built.positions.dtype, built.num_joints, built.skipped) == (np.float32, 22, ())
    assert not built.positions.flags.writeable
    np.testing.assert_array_equal(built.sequence_index, np.arange(6))
    for name in ("num_frames", "fps_numerator", "fps_denominator"):
        np.testing.assert_array_equal(getattr(built, name), store.sequences[name])
    for n in range(built.num_sequences):
        np.testing.assert_array_equal(built.sequence_positions(n), map_joints(store.read(n), "smpl22"))
    open_cache(store)
    assert len(reports) == 8, "an existing cache is opened, not built"


def test_a_filter_and_sequences_that_do_not_fit(mixed_store):
    store = mk.Store.open(mixed_store)
    everything = open_cache(store)
    assert list(everything.sequence_index) == [0, 2]
    assert [(each.sequence_index, each.sequence_id) for each in everything.skipped] == [(1, "chain")]
    tests = open_cache(store, where="split = 'test'")
    assert list(tests.sequence_index) == [2]
    assert tests.path != everything.path
    np.testing.assert_array_equal(tests.positions, store.read("long").joint_positions)
    assert open_cache(store, layout="kit21", where="split = 'test'").num_joints == mk.KIT21.num_joints
    native = open_cache(store, layout="native", where="num_joints = 3")
    np.testing.assert_array_equal(native.positions, store.read("chain").joint_positions)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"layout": "smpl"}, "'smpl'"),
        ({"layout": "native"}, "3, 22"),
        ({"where": "no_such_column > 1"}, "no_such_column"),
        ({"where": "sequence_id = 'chain'"}, "1 chosen"),
    ],
)
def test_invalid_requests(mixed_store, options, says):
    with pytest.raises(UsageError, match=says):
        open_cache(mk.Store.open(mixed_store), **options)


def test_a_cache_follows_the_store(small_store, make_motion):
    first = open_cache(mk.Store.open(small_store))
    sums(first)
    (small_store / "cache" / "mine").mkdir()
    change(small_store, make_motion)
    second = open_cache(mk.Store.open(small_store))
    assert second.num_sequences == 7
    assert not first.path.exists(), "the cache of an earlier state is removed"
    assert first.positions[-1].shape == (22, 3), "and stays valid where it is mapped"
    assert set(folders(small_store)) == {second.path, small_store / "cache" / "mine"}
    assert compact(small_store)
    assert not second.path.exists(), "it holds what may have been removed from the store"


def test_a_cache_travels_to_another_process(small_store, make_motion):
    built = open_cache(mk.Store.open(small_store))
    pickled = pickle.dumps(built)
    assert len(pickled) < 1000, "the map is opened again, not copied"
    again = pickle.loads(pickled)  # noqa: S301 - our own bytes, as a data loader's worker gets them
    np.testing.assert_array_equal(again.positions, built.positions)
    change(small_store, make_motion)
    open_cache(mk.Store.open(small_store))
    with pytest.raises(DamagedFileError, match=r"\.npy|cache"):
        pickle.loads(pickled)  # noqa: S301


def test_a_killed_builder_leaves_nothing_that_is_used(small_store):
    store = mk.Store.open(small_store)
    for step in itertools.count():
        if not killed_before(step, small_store, lambda: sums(open_cache(store))):
            break
        built = open_cache(store)
        np.testing.assert_array_equal(sums(built)[:, 0], built.positions.sum((1, 2)))
        for n in range(built.num_sequences):
            np.testing.assert_array_equal(built.sequence_positions(n), store.read(n).joint_positions)
        assert folders(small_store) == [built.path], "what a killed builder left is removed"
        shutil.rmtree(small_store / "cache")
    assert step > 4


@pytest.mark.parametrize("name", ["positions.npy", "cache.json", "sums.npy"])
@pytest.mark.parametrize("damage", ["cut", "remove"])
def test_an_incomplete_cache_is_built_again(small_store, name, damage, recwarn):
    store = mk.Store.open(small_store)
    built = open_cache(store)
    positions, derived = built.positions.copy(), sums(built)
    path = built.path / name
    content = path.read_bytes()
    path.unlink()
    if damage != "remove":
        path.write_bytes(content[: len(content) // 3])
    again = open_cache(store)
    np.testing.assert_array_equal(again.positions, positions)
    np.testing.assert_array_equal(sums(again), derived)
    assert len(recwarn) == (0 if (name, damage) == ("sums.npy", "remove") else 1)


def test_caches_in_another_folder(small_store, tmp_path, monkeypatch):
    monkeypatch.setenv("MOTIONKIT_CACHE", str(tmp_path / "scratch"))
    store = mk.Store.open(small_store)
    assert open_cache(store).path.parent == tmp_path / "scratch" / store.fingerprint
    assert not (small_store / "cache").exists()
